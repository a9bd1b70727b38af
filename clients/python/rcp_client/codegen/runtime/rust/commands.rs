/// An action or a service.
pub struct Command<I, O> {
    path: &'static str,
    of: PhantomData<(I, O)>,
}

impl<I: Value, O: Value> Command<I, O> {
    /// Begin, under a key of your own for each act, such as the number of an order: the gateway acts once for a key,
    /// whether it is sent again after a lost connection or by a program that was started again.
    pub fn start<'a>(&self, gateway: &'a Gateway, key: &str, input: &I) -> Result<Running<'a, O>, Error> {
        let header = format!("Idempotency-Key: {}\r\n", key);
        let reply = gateway.insist("POST", &format!("/context{}", self.path), Some(&input.to_json()), &header, false)?;
        let at = format!("/commands/{}", reply.get("command").as_text());
        Ok(Running { gateway, at, of: PhantomData })
    }
}

/// A command that was accepted.
pub struct Running<'a, O> {
    gateway: &'a Gateway,
    at: String,
    of: PhantomData<O>,
}

impl<'a, O: Value> Running<'a, O> {
    /// Return the result, or what it ended with.
    pub fn wait(&self) -> Result<O, Error> {
        loop {
            let reply = self.gateway.insist("GET", &self.at, None, "", true)?;
            let state = reply.get("body");
            match (state.get("status").as_text(), state.get("error")) {
                ("completed", _) => return O::from_json(state.get("body")),
                ("failed" | "rejected" | "cancelled", error) => return Err(failure(error, state.get("command"))),
                _ => sleep(POLL),
            }
        }
    }

    /// Have the robot told to stop; `wait` returns once it has ended the command.
    pub fn cancel(&self) -> Result<(), Error> {
        self.gateway.insist("DELETE", &self.at, None, "", true).map(|_| ())
    }
}
