const POLL: Duration = Duration::from_millis(200);
const ATTEMPT: Duration = Duration::from_secs(10);
const PATIENCE: Duration = Duration::from_secs(30);
const SILENCE: Duration = Duration::from_secs(45); // the gateway sends a comment every 15 s
const FIRST_PAUSE: Duration = Duration::from_millis(250);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);

/// A gateway, over HTTP and server-sent events without TLS: for one on this machine, or behind a proxy here.
pub struct Gateway {
    host: String,
    token: String,
}

/// A response, whose body is read as it comes.
struct Reply {
    status: u16,
    body: BufReader<Box<dyn Read>>,
}

/// The pieces of a body as one, up to the last.
struct Chunks {
    inner: BufReader<TcpStream>,
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

impl Gateway {
    /// Nothing is sent yet. The token may be empty.
    pub fn new(url: &str, token: &str) -> Result<Gateway, Error> {
        match url.strip_prefix("http://") {
            Some(host) => Ok(Gateway { host: host.trim_end_matches('/').into(), token: token.into() }),
            None => Err(Error::local("bad_request", format!("the address has to begin with http://, not {}", url))),
        }
    }

    fn connect(&self) -> io::Result<TcpStream> {
        let mut outcome = Err(io::Error::from(io::ErrorKind::NotFound));
        for address in self.host.to_socket_addrs()? {
            outcome = TcpStream::connect_timeout(&address, ATTEMPT);
            if outcome.is_ok() {
                break;
            }
        }
        outcome
    }

    fn open(&self, method: &str, path: &str, body: Option<&Json>, header: &str, silence: Duration) -> Result<Reply, Error> {
        let mut stream = self.connect()?;
        stream.set_read_timeout(Some(silence))?;
        stream.set_write_timeout(Some(ATTEMPT))?;
        let body = body.map_or(String::new(), |body| body.to_string());
        let mut head = format!("{} /rcp/v1{} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n{}", method, path, self.host, header);
        if !self.token.is_empty() {
            head += &format!("Authorization: Bearer {}\r\n", self.token);
        }
        if !body.is_empty() {
            head += &format!("Content-Type: application/json\r\nContent-Length: {}\r\n", body.len());
        }
        stream.write_all(format!("{}\r\n{}", head, body).as_bytes())?;
        let mut lines = BufReader::new(stream);
        let mut line = String::new();
        lines.read_line(&mut line)?;
        let status = line.split(' ').nth(1).and_then(|code| code.parse().ok());
        let status = status.ok_or_else(|| Error::local("connection_lost", "the connection was closed".into()))?;
        let (mut size, mut chunked) = (0, false);
        loop {
            line.clear();
            if lines.read_line(&mut line)? == 0 {
                return Err(Error::local("connection_lost", "the connection was closed".into()));
            }
            let lower = line.trim().to_ascii_lowercase();
            if lower.is_empty() {
                break;
            } else if let Some(length) = lower.strip_prefix("content-length:") {
                size = length.trim().parse().unwrap_or(0);
            } else if lower.starts_with("transfer-encoding:") {
                chunked = true;
            }
        }
        let body: Box<dyn Read> = if chunked {
            Box::new(Chunks { inner: lines, left: 0, over: false })
        } else {
            Box::new(lines.take(size))
        };
        Ok(Reply { status, body: BufReader::new(body) })
    }

    fn ask(&self, method: &str, path: &str, body: Option<&Json>, header: &str) -> Result<Json, Error> {
        decoded(self.open(method, path, body, header, ATTEMPT)?)
    }

    /// Ask again while no answer comes. What may have begun is not refused by a refusal that passes: `begun` says that
    /// it may have before, and each request that is lost says so too.
    fn insist(&self, method: &str, path: &str, body: Option<&Json>, header: &str, begun: bool) -> Result<Json, Error> {
        let (end, mut lost) = (Instant::now() + PATIENCE, None);
        loop {
            match self.ask(method, path, body, header) {
                Err(error) if error.code == "connection_lost" => lost = Some(error),
                Err(error) if error.retryable && error.command.is_empty() && (begun || lost.is_some()) => {
                    if Instant::now() >= end {
                        return Err(lost.unwrap_or(error));
                    }
                }
                outcome => return outcome,
            }
            match lost {
                Some(error) if Instant::now() >= end => return Err(error),
                _ => sleep(POLL),
            }
        }
    }
}

fn decoded(mut reply: Reply) -> Result<Json, Error> {
    let mut text = String::new();
    reply.body.read_to_string(&mut text)?;
    let found = Json::parse(&text).map_err(|_| Error::local("connection_lost", "the answer was cut off".into()))?;
    match found.get("error") {
        Json::Null => Ok(found),
        error => Err(failure(error, found.get("command"))),
    }
}

fn failure(error: &Json, command: &Json) -> Error {
    Error {
        command: command.as_text().into(),
        code: error.get("code").as_text().into(),
        message: error.get("message").as_text().into(),
        remedy: error.get("remedy").as_text().into(),
        retryable: error.get("retryable") == &Json::Bool(true),
    }
}
