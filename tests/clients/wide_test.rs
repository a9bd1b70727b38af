//! Integers beyond 2^53 at a real gateway. Compiled beside a generated rcp.rs.

mod rcp;

use rcp::Json::{Float, Int, List, Map, Text};

#[test]
fn wide_integers_come_and_go_as_they_are() {
    let gateway = rcp::Gateway::new(&std::env::var("RCP_URL").unwrap(), "").unwrap();
    let loose = |first| Map([("n".into(), List(vec![first, Int(5), Float(5.0), Text("5".into())]))].into());
    // Of any type, the gateway writes a wide one as its digits.
    let any = loose(Text("9007199254740993".into()));
    let expected = rcp::Parcel { i64: i64::MIN, u64: u64::MAX, small: 5, any };
    assert_eq!(rcp::AlphaParcel.get.read(&gateway).unwrap(), expected);
    let mut heard = None;
    rcp::AlphaParcel.get.watch(&gateway, 0.0, |update| heard.replace(update.body).is_some()).unwrap();
    assert_eq!(heard.unwrap(), expected);
    let written = rcp::Parcel { i64: i64::MAX, u64: 1 << 63, small: -5, any: loose(Int((1 << 53) + 1)) };
    rcp::AlphaParcel.set.write(&gateway, &written, None).unwrap();
}
