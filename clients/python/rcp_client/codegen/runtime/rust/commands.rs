/// An action or a service.
pub struct Command<I, O> {
    path: &'static str,
    of: PhantomData<(I, O)>,
}

impl<I: Value, O: Value> Command<I, O> {
    /// Begin, under a key of your own for each act, such as the number of an order: the gateway acts once for a key,
    /// whether it is sent again after a lost connection or by a program that was started again.
    pub fn start<'a>(&self, gateway: &'a Gateway, key: &str, input: &I) -> Result<Running<'a, O>, Error> {
        gateway.check()?;
        let header = format!("Idempotency-Key: {}\r\n", key);
        let reply = gateway.insist("POST", &format!("/context{}", self.path), Some(&input.to_json()), &header, false)?;
        Ok(Running { gateway, reply, of: PhantomData })
    }
}

/// A command that was accepted, or has ended already.
pub struct Running<'a, O> {
    gateway: &'a Gateway,
    reply: Json,
    of: PhantomData<O>,
}

impl<'a, O: Value> Running<'a, O> {
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
            state = self.gateway.insist("GET", &self.at(), None, "", true)?.get("body").clone();
        }
    }

    /// Have the robot told to stop; `wait` returns once it has ended the command.
    pub fn cancel(&self) -> Result<(), Error> {
        match self.reply.get("status").as_text() {
            "completed" => Ok(()), // one of the gateway's own services, which has no id
            _ => self.gateway.insist("DELETE", &self.at(), None, "", true).map(|_| ()),
        }
    }

    fn at(&self) -> String {
        format!("/commands/{}", self.reply.get("command").as_text())
    }
}
