//! What the generated client does when a gateway is lost, busy or out of reach. Compiled beside a generated rcp.rs.

mod rcp;

use std::env::var;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex};
use std::thread::{scope, spawn, JoinHandle};
use std::time::{Duration, Instant};

const BUSY: &str = r#"{"error": {"code": "rate_limited", "retryable": true}}"#;
const BEGUN: &str = r#"{"status": "accepted", "command": "cmd-1"}"#;
const DONE: &str = r#"{"status": "completed"}"#;
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
    let request = received(&stream);
    stream.write_all(answer.as_bytes()).unwrap();
    request
}

fn received(stream: &TcpStream) -> String {
    let mut sent = BufReader::new(stream);
    let (mut request, mut line, mut size) = (String::new(), String::new(), 0);
    while line != "\r\n" {
        line.clear();
        if sent.read_line(&mut line).unwrap() == 0 {
            return String::new(); // hung up without a word
        }
        if let Some(length) = line.strip_prefix("Content-Length: ") {
            size = length.trim().parse().unwrap();
        }
        request += &line;
    }
    sent.take(size).read_to_string(&mut request).unwrap();
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
    let (gateway, served) = serve(answers(&[value, DONE, DONE]));
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

#[test]
fn what_no_gateway_has_confirmed_is_not_in_force() {
    let (gateway, served) = serve(answers(&[r#"{"message": "no healthy upstream"}"#, BEGUN]));
    for code in ["connection_lost", "bad_response"] {
        let lost = rcp::AlphaTicks.set.write(&gateway, &5, None).err().unwrap();
        assert_eq!(lost.code, code);
    }
    served.join().unwrap();
}

#[test]
fn a_key_cannot_add_headers() {
    let gateway = rcp::Gateway::new("http://127.0.0.1:1", "").unwrap();
    let refused = rcp::AlphaDrive.start(&gateway, "order-1\r\nAuthorization: Bearer other", &1.5).err().unwrap();
    assert_eq!(refused.code, "bad_request");
}

#[test]
fn a_token_or_an_address_cannot_add_headers() {
    let over = |url: &str, token: &str| rcp::Gateway::over(url, token, |target| Ok(Box::new(target.tcp()?))).err().map(|error| error.code);
    let new = |url: &str, token: &str| rcp::Gateway::new(url, token).err().map(|error| error.code);
    for (url, token) in [("http://r", "key\n"), ("http://r", "key\r\nX: 1"), ("http://r\r\nX: 1", "key"), ("http://r/a\n", "key")] {
        assert_eq!(new(url, token).as_deref(), Some("bad_request"), "{:?}", (url, token));
        assert_eq!(over(url, token).as_deref(), Some("bad_request"), "{:?}", (url, token));
    }
    assert_eq!(new("http://r", "key"), None);
}

const HELD: &str = r#"{"status": "completed", "body": {"lease": "lease-1"}}"#;

#[test]
fn a_connection_of_ones_own_is_told_where_it_leads() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let served = spawn(move || one(&listener, &answer(DONE)));
    let (told, asked) = sync_channel(8);
    let gateway = rcp::Gateway::over("https://robots.example/site/", "key", move |target| {
        told.send((target.host.clone(), target.port)).unwrap();
        let here = rcp::Target { host: address.ip().to_string(), port: address.port(), silence: target.silence };
        Ok(Box::new(here.tcp()?))
    });
    rcp::AlphaTicks.set.write(&gateway.unwrap(), &5, None).unwrap();
    let sent = served.join().unwrap();
    assert!(sent.starts_with("PUT /site/rcp/v1/context/tenant/alpha/param/ticks HTTP/1.1\r\nHost: robots.example\r\n"));
    assert_eq!(asked.iter().collect::<Vec<_>>(), [("robots.example".to_string(), 443)]);
}

#[test]
fn a_certificate_that_is_wrong_is_told_at_once() {
    let (told, asked) = sync_channel(8);
    let gateway = rcp::Gateway::over("https://[::1]:8443", "", move |target| {
        told.send((target.host.clone(), target.port)).unwrap();
        Err(io::Error::new(io::ErrorKind::InvalidData, "unknown issuer"))
    });
    let gateway = gateway.unwrap();
    assert_eq!(rcp::AlphaDrive.start(&gateway, "order-1", &1.5).err().unwrap().code, "untrusted");
    drop(gateway);
    assert_eq!(asked.iter().collect::<Vec<_>>(), [("::1".to_string(), 8443)]);
}

#[test]
fn a_certificate_that_is_wrong_for_a_while_ends_nothing_that_may_have_begun() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let served = spawn(move || ["", BEGUN, THERE].map(|body| one(&listener, &answer(body))));
    let calls = AtomicUsize::new(0);
    let gateway = rcp::Gateway::over("https://robots.example", "", move |target| {
        match calls.fetch_add(1, Ordering::SeqCst) {
            1 | 3 => Err(io::Error::new(io::ErrorKind::InvalidData, "unknown issuer")),
            _ => Ok(Box::new(rcp::Target { host: "127.0.0.1".into(), port, silence: target.silence }.tcp()?)),
        }
    });
    let gateway = gateway.unwrap();
    assert_eq!(rcp::AlphaDrive.start(&gateway, "order-1", &1.5).unwrap().wait().unwrap(), "there");
    served.join().unwrap();
}

#[test]
fn an_address_that_is_none_is_refused() {
    for wrong in ["robots.example", "ftp://robots.example", "http://robots.example:http", "https://robots.example"] {
        assert_eq!(rcp::Gateway::new(wrong, "").err().unwrap().code, "bad_request");
    }
}

const ENDED: &str = r#"{"status": "completed", "body": {"status": "cancelled", "error": {"code": "cancelled"}}}"#;
const TTL: Duration = Duration::from_millis(600);

/// Grant a lease and hang up on its renewals; answer the rest as told, up to the first GET. Returns the lines of the rest.
fn unrenewed(told: fn(&str) -> &'static str) -> (rcp::Gateway, JoinHandle<Vec<String>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let served = spawn(move || {
        let (mut lines, mut granted) = (Vec::<String>::new(), false);
        while !lines.last().map_or(false, |line| line.starts_with("GET ")) {
            let (mut stream, _) = listener.accept().unwrap();
            let line = received(&stream).lines().next().unwrap_or("").to_string();
            let body = match line.contains("/system/leases") {
                true if granted => "",
                true => HELD,
                false => told(&line),
            };
            granted = true;
            stream.write_all(answer(body).as_bytes()).unwrap();
            if !line.contains("/system/leases") {
                lines.push(line);
            }
        }
        lines
    });
    (rcp::Gateway::new(&url, "").unwrap(), served)
}

fn words(lines: &[String]) -> Vec<&str> {
    lines.iter().map(|line| line.split(' ').next().unwrap()).collect()
}

#[test]
fn a_lease_that_cannot_be_renewed_is_lost_when_its_time_is_over_and_its_command_is_cancelled() {
    let (gateway, served) = unrenewed(|line| if line.starts_with("GET ") { ENDED } else { BEGUN });
    let lease = gateway.lease("/tenant/alpha", TTL).unwrap();
    let running = rcp::AlphaDrive.start(&lease, "order-1", &1.5).unwrap();
    assert_eq!(lease.wait_lost(Duration::from_secs(60)).unwrap().code, "lease_lost");
    assert_eq!(running.wait().err().unwrap().code, "cancelled");
    assert_eq!(words(&served.join().unwrap()), ["POST", "DELETE", "GET"]);
}

#[test]
fn nothing_begins_under_a_lease_that_is_lost_while_no_answer_comes_and_what_had_begun_is_cancelled() {
    let (gateway, served) = unrenewed(|line| match line.split(' ').next().unwrap() {
        "POST" if !line.contains("?deadline=0.001 ") => "",
        "GET" => ENDED,
        _ => BEGUN,
    });
    let lease = gateway.lease("/tenant/alpha", TTL).unwrap();
    let lost = rcp::AlphaDrive.start(&lease, "order-1", &1.5).err().unwrap();
    assert_eq!((&*lost.code, &*lost.command), ("lease_lost", "cmd-1"));
    assert!(lost.message.contains("cancelled"), "{}", lost);
    let sent = served.join().unwrap();
    let posts = sent.len() - 2;
    assert!(posts > 1, "{:?}", sent);
    assert!(sent[..posts - 1].iter().all(|line| line.starts_with("POST ") && !line.contains("deadline")));
    assert_eq!(words(&sent[posts - 1..]), ["POST", "DELETE", "GET"]);
}

#[test]
fn what_connects_only_after_its_lease_is_lost_is_not_sent() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let sent = spawn(move || {
        one(&listener, &answer(HELD));
        loop {
            let (stream, _) = listener.accept().unwrap();
            let request = received(&stream);
            if !request.is_empty() && !request.contains("/system/leases") {
                return request;
            }
        }
    });
    let gate = Arc::new(Mutex::new(()));
    let passed = gate.clone();
    let gateway = rcp::Gateway::over("http://robots.example", "", move |target| {
        drop(passed.lock());
        Ok(Box::new(rcp::Target { host: "127.0.0.1".into(), port, silence: target.silence }.tcp()?))
    });
    let lease = gateway.unwrap().lease("/tenant/alpha", TTL).unwrap();
    let shut = gate.lock().unwrap();
    scope(|threads| {
        let started = threads.spawn(|| rcp::AlphaDrive.start(&lease, "order-1", &1.5).err().unwrap());
        let written = threads.spawn(|| rcp::AlphaTicks.set.write(&lease, &5, None).err().unwrap());
        lease.wait_lost(Duration::from_secs(60)).unwrap();
        drop(shut);
        for refused in [started.join().unwrap(), written.join().unwrap()] {
            assert_eq!((&*refused.code, &*refused.command), ("lease_lost", ""));
        }
    });
    assert!(!sent.is_finished());
}
