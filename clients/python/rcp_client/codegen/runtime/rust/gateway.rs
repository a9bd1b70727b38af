/// A gateway, over HTTP and server-sent events.
#[derive(Clone)]
pub struct Gateway {
    authority: String,
    host: String,
    port: u16,
    prefix: String,
    token: String,
    connector: Arc<Connector>,
    held: Option<Arc<Hold>>,
}

impl Gateway {
    /// A gateway without TLS: one on this machine, or behind a proxy here. Nothing is sent yet. The token may be empty.
    pub fn new(url: &str, token: &str) -> Result<Gateway, Error> {
        if url.starts_with("https://") {
            return Err(Error::local("bad_request", format!("{} needs TLS: use Gateway::over with a connector", url)));
        }
        Gateway::over(url, token, |target| Ok(Box::new(target.tcp()?)))
    }

    /// A gateway over connections of your own, such as TLS over `Target::tcp`. The connector is called for each request. If it
    /// fails with `InvalidData`, as TLS does for a wrong certificate, the request is not sent again.
    pub fn over<F>(url: &str, token: &str, connector: F) -> Result<Gateway, Error>
    where
        F: Fn(&Target) -> io::Result<Box<dyn Stream>> + Send + Sync + 'static,
    {
        let wrong = || Error::local("bad_request", format!("{:?} is no address like http://host:8080", url));
        if !printable(url) {
            return Err(wrong());
        }
        if !printable(token) {
            return Err(Error::local("bad_request", "a token has no control characters, such as the line break that a file ends with".into()));
        }
        let (plain, secure) = (url.strip_prefix("http://"), url.strip_prefix("https://"));
        let (authority, prefix) = match plain.or(secure).ok_or_else(wrong)?.split_once('/') {
            Some((authority, path)) => (authority, format!("/{}", path)),
            None => (plain.or(secure).unwrap_or(""), String::new()),
        };
        let (host, port) = match authority.rsplit_once(':') {
            Some((host, port)) if !port.ends_with(']') => (host, port.parse().map_err(|_| wrong())?),
            _ => (authority, if secure.is_some() { 443 } else { 80 }),
        };
        Ok(Gateway {
            authority: authority.into(),
            host: host.trim_start_matches('[').trim_end_matches(']').into(),
            port,
            prefix: prefix.trim_end_matches('/').into(),
            token: token.into(),
            connector: Arc::new(connector),
            held: None,
        })
    }

    fn connect(&self, silence: Duration) -> Result<Box<dyn Stream>, Error> {
        let target = Target { host: self.host.clone(), port: self.port, silence };
        (self.connector)(&target).map_err(unsent)
    }

    fn exchange(&self, mut stream: Box<dyn Stream>, method: &str, path: &str, body: Option<&Json>, header: &str) -> Result<Reply, Error> {
        let body = body.map_or(String::new(), |body| body.to_string());
        let mut head = format!("{} {}/rcp/v1{} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n{}", method, self.prefix, path, self.authority, header);
        if !self.token.is_empty() {
            head += &format!("Authorization: Bearer {}\r\n", self.token);
        }
        if !body.is_empty() {
            head += &format!("Content-Type: application/json\r\nContent-Length: {}\r\n", body.len());
        }
        let request = format!("{}\r\n{}", head, body);
        stream.write_all(request.as_bytes()).and_then(|()| stream.flush()).map_err(unsent)?;
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

    fn open(&self, method: &str, path: &str, body: Option<&Json>, header: &str, silence: Duration) -> Result<Reply, Error> {
        self.exchange(self.connect(silence)?, method, path, body, header)
    }

    /// Ask again while no answer comes; `begun` as for `insist`.
    fn inquire(&self, method: &str, path: &str, begun: bool) -> Result<Json, Error> {
        insist(begun, || decoded(self.open(method, path, None, "", ATTEMPT)?))
    }
}

/// Whether a text can be sent in the head of a request without ending its line.
fn printable(text: &str) -> bool {
    !text.contains(|letter: char| letter.is_control())
}

/// Ask again while no answer comes. What may have begun is not refused by a refusal that passes: `begun` says that
/// it may have before, and each request that is lost says so too.
fn insist(begun: bool, mut ask: impl FnMut() -> Result<Json, Error>) -> Result<Json, Error> {
    let (end, mut lost) = (Instant::now() + PATIENCE, None);
    loop {
        match ask() {
            Err(error) if error.code == "connection_lost" => lost = Some(error),
            Err(error) if error.code == "untrusted" && (begun || lost.is_some()) => lost = Some(error),
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

fn unsent(error: io::Error) -> Error {
    match error.kind() {
        io::ErrorKind::InvalidData => Error::local("untrusted", error.to_string()),
        _ => error.into(),
    }
}

fn decoded(mut reply: Reply) -> Result<Json, Error> {
    let mut text = String::new();
    reply.body.read_to_string(&mut text)?;
    let found = Json::parse(&text).map_err(|_| Error::local("connection_lost", "the answer was cut off".into()))?;
    match found.get("error") {
        // A proxy that has no gateway behind it speaks JSON too.
        Json::Null if found.get("status").as_text().is_empty() => {
            Err(Error::local("connection_lost", format!("HTTP {}: not an answer of a gateway", reply.status)))
        }
        Json::Null => Ok(found),
        error => Err(failure(error, found.get("command"))),
    }
}

/// Take the answer to what ends with it.
fn done(found: Json) -> Result<Json, Error> {
    match found.get("status").as_text() {
        "completed" => Ok(found),
        status => Err(Error::local("bad_response", format!("the gateway answered `{}`, not `completed`", status))),
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
