/// Exclusive control of a part of the tree, renewed by a thread until it is released, dropped or lost. It holds for
/// everything that is sent with the same token.
///
/// What takes a gateway takes a lease too. Once it is lost or given back, nothing is begun and written under it any more,
/// by its clones either. A command that was begun under it is cancelled by `wait` when it is lost, and goes on when it is
/// given back.
pub struct Lease {
    gateway: Gateway,
    id: String,
    hold: Arc<Hold>,
}

/// What is known of a lease by all who act under it.
struct Hold {
    state: Mutex<HoldState>,
    changed: Condvar,
}

struct HoldState {
    until: Instant,
    released: bool,
    lost: Option<Error>,
}

impl HoldState {
    /// A lease whose time is over is lost, whatever a renewal that is under way still brings.
    fn judge(&mut self) -> Option<Error> {
        if self.lost.is_none() && !self.released && Instant::now() >= self.until {
            let message = "the lease expired: it could not be renewed in time";
            self.lost = Some(Error::local("lease_lost", message.into()));
        }
        self.lost.clone()
    }
}

impl Hold {
    fn lost(&self) -> Option<Error> {
        self.state.lock().unwrap().judge()
    }

    fn check(&self) -> Result<(), Error> {
        let mut state = self.state.lock().unwrap();
        match state.judge() {
            Some(error) => Err(error),
            None if state.released => Err(Error::local("lease_lost", "the lease was given back".into())),
            None => Ok(()),
        }
    }

    /// Wait for the next renewal; return until when it has to have succeeded, or nothing if none is due any more.
    fn due(&self) -> Option<Instant> {
        let mut state = self.state.lock().unwrap();
        let until = state.until;
        let due = Instant::now() + until.saturating_duration_since(Instant::now()) / 3 + POLL;
        loop {
            let left = due.saturating_duration_since(Instant::now());
            if state.judge().is_some() || state.released {
                return None;
            }
            if left == Duration::ZERO {
                return Some(until);
            }
            state = self.changed.wait_timeout(state, left).unwrap().0;
        }
    }

    fn renewed(&self, until: Instant) {
        self.state.lock().unwrap().until = until;
    }

    fn lose(&self, error: Error) {
        let mut state = self.state.lock().unwrap();
        if !state.released && state.lost.is_none() {
            state.lost = Some(error);
            self.changed.notify_all();
        }
    }

    /// Note that nobody needs it any more; return whether it is to be given back.
    fn leave(&self) -> bool {
        let mut state = self.state.lock().unwrap();
        let held = state.judge().is_none() && !state.released;
        state.released = true;
        self.changed.notify_all();
        held
    }
}

impl Gateway {
    /// Take a lease on a scope, such as `/tenant/alpha/actuator`; again while no answer comes, at most for 30 s. It lapses
    /// `ttl` after the last renewal that succeeded.
    pub fn lease(&self, scope: &str, ttl: Duration) -> Result<Lease, Error> {
        let (gateway, end) = (Gateway { held: None, ..self.clone() }, Instant::now() + PATIENCE);
        let asked = [("scope", Json::Text(scope.into())), ("ttl", Json::Float(ttl.as_secs_f64()))];
        let (began, taken) = loop {
            let began = Instant::now();
            match gateway.ask_lease("acquire", &asked, ATTEMPT) {
                Err(error) if error.code == "connection_lost" && began < end => sleep(POLL),
                outcome => break (began, outcome?),
            }
        };
        let id = String::from_json(taken.get("lease"))?;
        let state = Mutex::new(HoldState { until: began + ttl, released: false, lost: None });
        let hold = Arc::new(Hold { state, changed: Condvar::new() });
        let (keeper, kept, held) = (gateway.clone(), id.clone(), hold.clone());
        spawn(move || keeper.keep_lease(&kept, ttl, &held));
        Ok(Lease { gateway: Gateway { held: Some(hold.clone()), ..gateway }, id, hold })
    }

    fn keep_lease(&self, id: &str, ttl: Duration, hold: &Hold) {
        while let Some(until) = hold.due() {
            let began = Instant::now();
            let attempt = until.saturating_duration_since(began) / 2; // one that hangs leaves time for another
            let asked = [("lease", Json::Text(id.into())), ("ttl", Json::Float(ttl.as_secs_f64()))];
            match self.ask_lease("renew", &asked, attempt.clamp(Duration::from_millis(1), ATTEMPT)) {
                Ok(_) => hold.renewed(began + ttl),
                Err(error) if error.retryable => drop(hold.lost()),
                Err(error) => hold.lose(error),
            }
        }
    }

    fn ask_lease(&self, what: &str, asked: &[(&str, Json)], silence: Duration) -> Result<Json, Error> {
        let mut body: BTreeMap<String, Json> = asked.iter().map(|(name, value)| (name.to_string(), value.clone())).collect();
        body.insert("do".into(), Json::Text(what.into()));
        let reply = self.open("POST", "/context/system/leases?wait=10", Some(&Json::Map(body)), "", silence)?;
        decoded(reply).and_then(done).map(|reply| reply.get("body").clone())
    }

    /// Refuse what would act under a lease that is lost or was given back.
    fn check(&self) -> Result<(), Error> {
        self.held.as_ref().map_or(Ok(()), |held| held.check())
    }

    fn lost(&self) -> Option<Error> {
        self.held.as_ref().and_then(|held| held.lost())
    }
}

impl Lease {
    /// Why the lease is lost, if it is.
    pub fn lost(&self) -> Option<Error> {
        self.hold.lost()
    }

    /// Wait until the lease is lost, and return why, or nothing after `timeout`. For a thread that watches it.
    pub fn wait_lost(&self, timeout: Duration) -> Option<Error> {
        let end = Instant::now() + timeout;
        let mut state = self.hold.state.lock().unwrap();
        loop {
            let lost = state.judge();
            let left = end.saturating_duration_since(Instant::now());
            if lost.is_some() || left == Duration::ZERO {
                return lost;
            }
            let left = left.min(state.until.saturating_duration_since(Instant::now()));
            state = self.hold.changed.wait_timeout(state, left).unwrap().0;
        }
    }

    /// Give the lease back. One that is lost already is no error.
    pub fn release(self) -> Result<(), Error> {
        self.give_back()
    }

    fn give_back(&self) -> Result<(), Error> {
        if !self.hold.leave() {
            return Ok(());
        }
        let asked = [("lease", Json::Text(self.id.clone()))];
        self.gateway.ask_lease("release", &asked, ATTEMPT).map(|_| ())
    }
}

impl Deref for Lease {
    type Target = Gateway;
    fn deref(&self) -> &Gateway {
        &self.gateway
    }
}

impl Drop for Lease {
    /// Gives the lease back; one that cannot be lapses.
    fn drop(&mut self) {
        let _ = self.give_back();
    }
}
