const POLL: Duration = Duration::from_millis(200);
const ATTEMPT: Duration = Duration::from_secs(10);
const PATIENCE: Duration = Duration::from_secs(30);
const SILENCE: Duration = Duration::from_secs(45); // the gateway sends a comment every 15 s
const FIRST_PAUSE: Duration = Duration::from_millis(250);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);

/// Whatever can be read and written: a socket, or TLS over one.
pub trait Stream: Read + Write {}

impl<T: Read + Write> Stream for T {}

type Connector = dyn Fn(&Target) -> io::Result<Box<dyn Stream>> + Send + Sync;

/// Where a connection leads.
pub struct Target {
    /// A name, as its certificate has it, or an address without brackets.
    pub host: String,
    pub port: u16,
    /// After this time without a byte, a read has to fail.
    pub silence: Duration,
}

impl Target {
    /// Connect by TCP, with the times that all connections have.
    pub fn tcp(&self) -> io::Result<TcpStream> {
        let attempt = ATTEMPT.min(self.silence);
        let mut outcome = Err(io::Error::from(io::ErrorKind::NotFound));
        for address in (&*self.host, self.port).to_socket_addrs()? {
            outcome = TcpStream::connect_timeout(&address, attempt);
            if outcome.is_ok() {
                break;
            }
        }
        let stream = outcome?;
        stream.set_read_timeout(Some(self.silence))?;
        stream.set_write_timeout(Some(attempt))?;
        Ok(stream)
    }
}

/// A response, whose body is read as it comes.
struct Reply {
    status: u16,
    body: BufReader<Box<dyn Read>>,
}

/// The pieces of a body as one, up to the last.
struct Chunks {
    inner: BufReader<Box<dyn Stream>>,
    left: usize,
    over: bool,
}

impl Read for Chunks {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if self.left == 0 && !self.over {
            let mut line = String::new();
            while line.trim().is_empty() {
                line.clear();
                if self.inner.read_line(&mut line)? == 0 {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
            }
            let size = line.trim().split(';').next().unwrap_or("");
            self.left = usize::from_str_radix(size, 16).map_err(|_| io::Error::from(io::ErrorKind::InvalidData))?;
            self.over = self.left == 0;
        }
        let most = into.len().min(self.left);
        let size = self.inner.read(&mut into[..most])?;
        if size == 0 && most > 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        self.left -= size;
        Ok(size)
    }
}
