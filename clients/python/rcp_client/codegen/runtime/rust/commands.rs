/// An action or a service.
pub struct Command<I, O> {
    path: &'static str,
    of: PhantomData<(I, O)>,
}

impl<I: Value, O: Value> Command<I, O> {
    /// Begin, under a key of your own for each act, such as the number of an order: the gateway acts once for a key,
    /// whether it is sent again after a lost connection or by a program that was started again.
    ///
    /// Once the lease is lost that it is sent under, nothing begins any more: what had begun is cancelled and followed to
    /// its end, and the error is why the lease was lost, with what became of the command.
    pub fn start<'a>(&self, gateway: &'a Gateway, key: &str, input: &I) -> Result<Running<'a, O>, Error> {
        gateway.check()?;
        if !printable(key) {
            return Err(Error::local("bad_request", "a key has no control characters".into()));
        }
        let header = format!("Idempotency-Key: {}\r\n", key);
        let mut sent = false;
        let outcome = insist(false, || {
            let stream = gateway.connect(ATTEMPT)?;
            let mut path = format!("/context{}", self.path);
            match gateway.check() {
                Ok(()) => sent = true,
                Err(error) if !sent => return Err(error),
                // Nobody wants it any more: if it is not under way, it is not to begin.
                Err(_) => path += "?deadline=0.001",
            }
            decoded(gateway.exchange(stream, "POST", &path, Some(&input.to_json()), &header)?)
        });
        match gateway.lost() {
            Some(lost) if sent => Running::ended(gateway, lost, outcome),
            _ => outcome.map(|reply| Running { gateway, reply, of: PhantomData }),
        }
    }
}

/// A command that was accepted, or has ended already.
pub struct Running<'a, O> {
    gateway: &'a Gateway,
    reply: Json,
    of: PhantomData<O>,
}

impl<'a, O: Value> Running<'a, O> {
    /// End what was sent under a lease that is lost.
    fn ended(gateway: &'a Gateway, lost: Error, outcome: Result<Json, Error>) -> Result<Self, Error> {
        let (about, command) = match outcome {
            Err(error) => (error.clone(), error.command),
            Ok(reply) => {
                let command = reply.get("command").as_text().into();
                let running = Running { gateway, reply, of: PhantomData };
                match running.wait() {
                    Ok(_) => return Ok(running),
                    Err(error) => (error, command),
                }
            }
        };
        Err(Error { command, message: format!("{}; the command that was sent before: {}", lost.message, about), ..lost })
    }

    /// Return the result, or what it ended with. A command that was begun under a lease is cancelled when that is lost.
    pub fn wait(&self) -> Result<O, Error> {
        let (mut state, mut cancelled) = (self.reply.clone(), false);
        loop {
            match (state.get("status").as_text(), state.get("error")) {
                ("completed", _) => return O::from_json(state.get("body")),
                ("failed" | "rejected" | "cancelled", error) => return Err(failure(error, state.get("command"))),
                _ => sleep(POLL),
            }
            if !cancelled && self.gateway.lost().is_some() {
                self.cancel()?;
                cancelled = true;
            }
            state = self.gateway.inquire("GET", &self.at(), true)?.get("body").clone();
        }
    }

    /// Have the robot told to stop; `wait` returns once it has ended the command.
    pub fn cancel(&self) -> Result<(), Error> {
        match self.reply.get("status").as_text() {
            "completed" => Ok(()), // one of the gateway's own services, which has no id
            _ => self.gateway.inquire("DELETE", &self.at(), true).map(|_| ()),
        }
    }

    fn at(&self) -> String {
        format!("/commands/{}", self.reply.get("command").as_text())
    }
}
