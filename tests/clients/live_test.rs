//! Leases of the generated client, and connections of one's own, at a real gateway. Compiled beside a generated rcp.rs.

mod rcp;

use std::env::var;
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::Arc;
use std::thread::{scope, sleep};
use std::time::{Duration, Instant};

const PATIENCE: Duration = Duration::from_secs(60);
const TTL: Duration = Duration::from_secs(3);

/// A connection that counts what is sent over it, as one with TLS would encrypt it.
struct Counted {
    inner: TcpStream,
    sent: Arc<AtomicUsize>,
}

impl Read for Counted {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.inner.read(into)
    }
}

impl Write for Counted {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        self.sent.fetch_add(1, Ordering::SeqCst);
        self.inner.write(data)
    }
    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

fn of(token: &str) -> rcp::Gateway {
    rcp::Gateway::new(&var("RCP_URL").unwrap(), &var(token).unwrap()).unwrap()
}

fn counted() -> (rcp::Gateway, Arc<AtomicUsize>) {
    let sent = Arc::new(AtomicUsize::new(0));
    let counter = sent.clone();
    let connect = move |target: &rcp::Target| -> io::Result<Box<dyn rcp::Stream>> {
        Ok(Box::new(Counted { inner: target.tcp()?, sent: counter.clone() }))
    };
    let gateway = rcp::Gateway::over(&var("RCP_URL").unwrap(), &var("RCP_TOKEN").unwrap(), connect);
    (gateway.unwrap(), sent)
}

fn until(so: impl Fn() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !so() {
        assert!(Instant::now() < end, "not in time");
        sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_lease_keeps_others_out_is_renewed_and_given_back_when_it_is_dropped() {
    let ((mine, sent), other) = (counted(), of("RCP_ADMIN"));
    let lease = mine.lease("/tenant/alpha", TTL).unwrap();
    assert_eq!(sent.load(Ordering::SeqCst), 1);
    let write = |by: &rcp::Gateway| rcp::AlphaSpeedLimit.set.write(by, &0.9, None);
    assert_eq!(write(&other).err().unwrap().code, "lease_held");
    write(&lease).unwrap();
    until(|| sent.load(Ordering::SeqCst) >= 5); // the third renewal begins when the first lifetime is over
    assert!(lease.lost().is_none());
    assert!(lease.wait_lost(Duration::from_millis(1)).is_none());
    assert_eq!(write(&other).err().unwrap().code, "lease_held");
    let copy = lease.clone();
    drop(lease);
    assert_eq!(write(&copy).err().unwrap().code, "lease_lost");
    rcp::AlphaSpeedLimit.get.read(&copy).unwrap();
    write(&other).unwrap();
    mine.lease("/tenant/alpha", TTL).unwrap().release().unwrap();
    write(&other).unwrap();
    let refused = mine.lease("/tenant/nobody", TTL).err().unwrap();
    assert!(!refused.retryable, "{}", refused);
}

#[test]
fn a_lost_lease_is_told_and_nothing_goes_on_under_it() {
    let (mine, admin) = (of("RCP_TOKEN"), of("RCP_ADMIN"));
    let lease = mine.lease("/tenant/beta", TTL).unwrap();
    let goal = |x: f64, y: f64| rcp::MoveToIn {
        position: rcp::GoalPointIn { x, y, ..Default::default() },
        speed: Some(0.02),
        ..Default::default()
    };
    let running = rcp::BetaMoveTo.start(&lease, &format!("beta-{:?}", Instant::now()), &goal(2.5, 0.5)).unwrap();
    let stop = |reset: bool| {
        let input = rcp::EstopRequestIn { scope: Some("/tenant/beta".into()), reset: Some(reset), ..Default::default() };
        let key = format!("stop-{:?}", Instant::now());
        rcp::SystemEstop.start(&admin, &key, &Some(input)).unwrap().wait().unwrap();
    };
    scope(|threads| {
        let watching = threads.spawn(|| lease.wait_lost(PATIENCE));
        stop(false);
        assert_eq!(watching.join().unwrap().unwrap().code, "lease_lost");
    });
    assert_eq!(running.wait().err().unwrap().code, "cancelled");
    stop(true);
    let refused = rcp::BetaSpeedLimit.set.write(&lease, &0.9, None).err().unwrap();
    assert_eq!(refused.code, "lease_lost");
    let refused = rcp::BetaMoveTo.start(&lease, "never", &goal(2.5, 0.5)).err().unwrap();
    assert_eq!((&*refused.code, &*refused.command), ("lease_lost", ""));
    rcp::BetaSpeedLimit.get.read(&lease).unwrap(); // who only looks needs no lease
    lease.release().unwrap();
}
