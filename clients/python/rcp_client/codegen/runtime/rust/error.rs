/// What the gateway refused or failed to do; `connection_lost` and `bad_response` are found here.
#[derive(Clone, Debug)]
pub struct Error {
    pub code: String,
    pub message: String,
    pub remedy: String,
    pub retryable: bool,
    /// The command that it is about; empty where none is known to have begun.
    pub command: String,
}

impl Error {
    fn local(code: &str, message: String) -> Error {
        let retryable = code == "connection_lost";
        Error { code: code.into(), message, remedy: String::new(), retryable, command: String::new() }
    }
}

impl From<io::Error> for Error {
    fn from(error: io::Error) -> Error {
        Error::local("connection_lost", error.to_string())
    }
}

impl fmt::Display for Error {
    fn fmt(&self, out: &mut fmt::Formatter) -> fmt::Result {
        write!(out, "{}: {}", self.code, self.message)
    }
}

impl std::error::Error for Error {}
