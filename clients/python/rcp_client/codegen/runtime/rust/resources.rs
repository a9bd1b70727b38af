/// A path that can be read and watched.
pub struct Readable<T> {
    path: &'static str,
    of: PhantomData<T>,
}

/// One sample of a watched path.
pub struct Update<T> {
    pub seq: i64,
    pub body: T,
}

impl<T: Value> Readable<T> {
    /// Return the current value.
    pub fn read(&self, gateway: &Gateway) -> Result<T, Error> {
        T::from_json(done(gateway.inquire("GET", &format!("/context{}", self.path), false)?)?.get("body"))
    }

    /// Call `heard` with each new value, at most `rate` a second, 0 for all, until it returns false. A stream that is
    /// lost is opened again, and goes on after the last value that was heard.
    pub fn watch(&self, gateway: &Gateway, rate: f64, mut heard: impl FnMut(Update<T>) -> bool) -> Result<(), Error> {
        let (mut last, mut pause) = (String::new(), FIRST_PAUSE);
        loop {
            let before = last.clone();
            match self.stream(gateway, rate, &mut last, &mut heard) {
                Ok(()) => return Ok(()),
                Err(error) if !error.retryable => return Err(error),
                Err(_) if last != before => pause = FIRST_PAUSE,
                Err(_) => pause = LONGEST_PAUSE.min(pause * 2),
            }
            sleep(pause);
        }
    }

    fn stream(&self, gateway: &Gateway, rate: f64, last: &mut String, heard: &mut impl FnMut(Update<T>) -> bool) -> Result<(), Error> {
        let mut path = format!("/events?path={}", self.path);
        if rate > 0.0 {
            path += &format!("&rate={}", rate);
        }
        let header = match last.is_empty() {
            true => String::new(),
            false => format!("Last-Event-ID: {}\r\n", last),
        };
        let mut reply = gateway.open("GET", &path, None, &header, SILENCE)?;
        if reply.status != 200 {
            return decoded(reply).map(|_| ());
        }
        let (mut event, mut id, mut data, mut line) = (String::new(), String::new(), String::new(), String::new());
        loop {
            line.clear();
            if reply.body.read_line(&mut line)? == 0 {
                return Err(Error::local("connection_lost", "the stream has ended".into()));
            }
            let text = line.trim_end();
            if let Some(name) = text.strip_prefix("event: ") {
                event = name.into();
            } else if let Some(name) = text.strip_prefix("id: ") {
                id = name.into();
            } else if let Some(more) = text.strip_prefix("data: ") {
                data += more;
            } else if text.is_empty() {
                if event == "update" {
                    let update = Json::parse(&data)?;
                    let (seq, body) = (i64::from_json(update.get("seq"))?, T::from_json(update.get("body"))?);
                    if !heard(Update { seq, body }) {
                        return Ok(());
                    }
                }
                if !id.is_empty() {
                    *last = id.clone(); // a comment, or a notice of what was lost, has none
                }
                event.clear();
                data.clear();
            }
        }
    }
}

/// A path that can be written.
pub struct Writable<T> {
    path: &'static str,
    of: PhantomData<T>,
}

impl<T: Value> Writable<T> {
    /// Set a value, once: after `connection_lost` it may be in force. If `valid_for` is given, the gateway stops the
    /// robot unless the value is written again in that time.
    pub fn write(&self, gateway: &Gateway, value: &T, valid_for: Option<Duration>) -> Result<(), Error> {
        gateway.check()?;
        let mut path = format!("/context{}", self.path);
        if let Some(time) = valid_for {
            path += &format!("?valid_for={}", time.as_secs_f64());
        }
        let stream = gateway.connect(ATTEMPT)?;
        gateway.check()?; // to connect may have taken longer than the lease lasted
        decoded(gateway.exchange(stream, "PUT", &path, Some(&value.to_json()), "")?).and_then(done).map(|_| ())
    }
}

/// A path that can be read, watched and written.
pub struct Setting<R, W> {
    pub get: Readable<R>,
    pub set: Writable<W>,
}
