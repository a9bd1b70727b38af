//! Drive a robot of `rcpd demo` with generated types, and Rust's own library alone.

mod rcp;

use std::env::var;
use std::thread::sleep;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

fn main() -> Result<(), rcp::Error> {
    let url = var("RCP_URL").unwrap_or("http://127.0.0.1:8080".into());
    let gateway = rcp::Gateway::new(&url, &var("RCP_TOKEN").unwrap_or_default())?;

    let mut left = 3;
    rcp::AlphaPose.watch(&gateway, 5.0, |update| {
        println!("{} x {:.2} m", update.seq, update.body.position.x);
        left -= 1;
        left > 0
    })?;

    match rcp::AlphaSpeedLimit.set.write(&gateway, &99.0, None) {
        Err(refused) => println!("refused: {}", refused.code),
        Ok(()) => println!("a speed of 99 m/s is in force"),
    }

    // Nobody else drives meanwhile. Once it is lost, commands under it are cancelled; dropped, it is given back.
    let lease = gateway.lease("/tenant/alpha", Duration::from_secs(10))?;

    // A key names what is done: sent twice, it is done once.
    let key = format!("visit-{}", SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos());
    let goal = |x: f64, speed: Option<f64>| rcp::MoveToIn {
        position: rcp::GoalPointIn { x, y: 0.5, ..Default::default() },
        speed,
        ..Default::default()
    };
    let first = rcp::AlphaMoveTo.start(&lease, &key, &goal(0.5, None))?;
    let again = rcp::AlphaMoveTo.start(&lease, &key, &goal(0.5, None))?;
    first.wait()?;
    again.wait()?;
    let pose = rcp::AlphaPose.read(&gateway)?;
    println!("there: x {:.1} y {:.1}", pose.position.x, pose.position.y);

    // A cancelled command has ended, and the robot is at rest, when `wait` returns.
    let far = rcp::AlphaMoveTo.start(&lease, &format!("{}-far", key), &goal(2.5, Some(0.02)))?;
    sleep(Duration::from_secs(1));
    far.cancel()?;
    match far.wait() {
        Err(ended) => println!("ended: {}", ended.code),
        Ok(_) => println!("it was there already"),
    }
    Ok(())
}
