//! What the generated client does when a gateway is lost, busy or out of reach. Compiled beside a generated rcp.rs.

mod rcp;

use std::env::var;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::thread::{spawn, JoinHandle};
use std::time::{Duration, Instant};

const BUSY: &str = r#"{"error": {"code": "rate_limited", "retryable": true}}"#;
const BEGUN: &str = r#"{"status": "accepted", "command": "cmd-1"}"#;
const THERE: &str = r#"{"status": "completed", "body": {"status": "completed", "body": "there"}}"#;

/// Give one answer for each connection, and return the requests.
fn serve(answers: Vec<String>) -> (rcp::Gateway, JoinHandle<Vec<String>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let served = spawn(move || answers.iter().map(|answer| one(&listener, answer)).collect());
    (rcp::Gateway::new(&url, "").unwrap(), served)
}

fn one(listener: &TcpListener, answer: &str) -> String {
    let (mut stream, _) = listener.accept().unwrap();
    let mut sent = BufReader::new(stream.try_clone().unwrap());
    let (mut request, mut line, mut size) = (String::new(), String::new(), 0);
    while line != "\r\n" {
        line.clear();
        sent.read_line(&mut line).unwrap();
        if let Some(length) = line.strip_prefix("Content-Length: ") {
            size = length.trim().parse().unwrap();
        }
        request += &line;
    }
    sent.take(size).read_to_string(&mut request).unwrap();
    stream.write_all(answer.as_bytes()).unwrap();
    request
}

/// An answer of several; an empty one is a connection that is lost.
fn answer(body: &str) -> String {
    match body {
        "" => String::new(),
        _ => format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\n\r\n{}", body.len(), body),
    }
}

fn answers(bodies: &[&str]) -> Vec<String> {
    bodies.iter().map(|body| answer(body)).collect()
}

/// The beginning of a stream that is cut.
fn stream(events: &str) -> String {
    format!("HTTP/1.1 200 OK\r\nContent-Length: 100000\r\n\r\n{}", events)
}

#[test]
fn a_refusal_that_passes_is_none_once_an_answer_was_lost() {
    let (gateway, served) = serve(answers(&["", BUSY, BEGUN, BUSY, THERE]));
    let running = rcp::AlphaDrive.start(&gateway, "order-1", &1.5).unwrap();
    assert_eq!(running.wait().unwrap(), "there");
    let sent: Vec<String> = served.join().unwrap();
    assert!(sent[..3].iter().all(|one| one.starts_with("POST ") && one.contains("\r\nIdempotency-Key: order-1\r\n")));
    assert!(sent[3..].iter().all(|one| one.starts_with("GET ")));
}

#[test]
fn a_refusal_of_what_was_sent_once_is_the_answer() {
    let (gateway, served) = serve(answers(&[BUSY]));
    let refused = rcp::AlphaDrive.start(&gateway, "order-1", &1.5).err().unwrap();
    assert_eq!((&*refused.code, &*refused.command), ("rate_limited", ""));
    served.join().unwrap();
}

#[test]
fn what_a_command_ended_with_is_the_answer() {
    let late = r#"{"command": "cmd-1", "error": {"code": "deadline_exceeded", "retryable": true}}"#;
    let (gateway, served) = serve(answers(&["", late]));
    let ended = rcp::AlphaDrive.start(&gateway, "order-1", &1.5).err().unwrap();
    assert_eq!((&*ended.code, &*ended.command), ("deadline_exceeded", "cmd-1"));
    served.join().unwrap();
}

#[test]
fn a_cancellation_is_sent_until_it_is_taken() {
    let (gateway, served) = serve(answers(&[BEGUN, BUSY, "", BEGUN]));
    rcp::AlphaDrive.start(&gateway, "order-1", &1.5).unwrap().cancel().unwrap();
    let sent: Vec<String> = served.join().unwrap();
    assert!(sent[1..].iter().all(|one| one.starts_with("DELETE ")));
}

#[test]
fn a_stream_goes_on_after_the_last_value_though_it_was_cut_before_the_next() {
    let update = "event: update\nid: 7\ndata: {\"seq\": 1, \"body\": 3}\n\n";
    let (gateway, served) = serve(vec![stream(update), stream(": still here\n\n"), stream(update)]);
    let mut left = 2;
    let heard = |_: rcp::Update<u64>| {
        left -= 1;
        left > 0
    };
    rcp::AlphaTicks.get.watch(&gateway, 0.0, heard).unwrap();
    let sent: Vec<String> = served.join().unwrap();
    assert!(!sent[0].contains("Last-Event-ID"));
    assert!(sent[1..].iter().all(|one| one.contains("\r\nLast-Event-ID: 7\r\n")));
}

#[test]
fn the_largest_integer_comes_and_goes() {
    let value = r#"{"status": "completed", "body": "18446744073709551615"}"#;
    let (gateway, served) = serve(answers(&[value, BEGUN, BEGUN]));
    let read = rcp::AlphaTicks.get.read(&gateway).unwrap();
    assert_eq!(read, u64::MAX);
    rcp::AlphaTicks.set.write(&gateway, &read, None).unwrap();
    rcp::AlphaTicks.set.write(&gateway, &5, None).unwrap();
    let sent: Vec<String> = served.join().unwrap();
    assert!(sent[1].ends_with("\r\n\r\n\"18446744073709551615\""));
    assert!(sent[2].ends_with("\r\n\r\n5"));
}

#[test]
fn a_machine_that_does_not_answer_is_not_waited_for_for_minutes() {
    let (gateway, began) = (rcp::Gateway::new(&var("RCP_SILENT").unwrap(), "").unwrap(), Instant::now());
    let lost = rcp::AlphaTicks.set.write(&gateway, &5, None).err().unwrap();
    assert_eq!(lost.code, "connection_lost");
    assert!(began.elapsed() < Duration::from_secs(60));
}
