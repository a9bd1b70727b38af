"""The part of the Rust output that is the same for every gateway."""

from __future__ import annotations

__all__ = ["CLIENT", "HEAD", "RESERVED"]

RESERVED = ("Gateway", "Error", "Json", "Value", "Readable", "Writable", "Setting", "Command", "Running",
            "Update", "Reply", "Parser", "Base64", "Vec", "Option", "String", "Box", "Some", "None", "Ok",
            "Err", "Result", "Default", "Self", "BTreeMap", "PhantomData", "Duration", "Instant",
            "TcpStream", "ToSocketAddrs", "Read", "Write", "BufRead", "BufReader", "Clone", "Debug", "PartialEq",
            "From", "Into", "Iterator", "ToString", "Drop", "Fn", "FnMut", "FnOnce", "Copy", "Send",
            "Sync", "Sized")  # fmt: skip
"""Names that no type of a gateway may have."""

HEAD = """
// Typed client of the gateway at URL, written by `rcpctl codegen --lang rust`.
//
//     let gateway = rcp::Gateway::new("URL", &token)?;
//     let pose = rcp::AlphaPose.read(&gateway)?;

#![allow(dead_code, non_upper_case_globals, non_snake_case, clippy::all)]

use std::collections::BTreeMap;
use std::fmt;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::marker::PhantomData;
use std::net::{TcpStream, ToSocketAddrs};
use std::thread::sleep;
use std::time::{Duration, Instant};
"""

CLIENT = r"""
/// Bytes, base64 on the wire.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Base64(pub Vec<u8>);

/// Any value.
#[derive(Clone, Debug, PartialEq)]
pub enum Json {
    Null,
    Bool(bool),
    Int(i64),
    Float(f64),
    Text(String),
    List(Vec<Json>),
    Map(BTreeMap<String, Json>),
}

impl Default for Json {
    fn default() -> Self {
        Json::Null
    }
}

impl Json {
    /// Parse a text.
    pub fn parse(text: &str) -> Result<Json, Error> {
        let mut parser = Parser { text: text.as_bytes(), at: 0, depth: 0 };
        let value = parser.value()?;
        parser.space();
        if parser.at < text.len() {
            return Err(parser.fault());
        }
        Ok(value)
    }

    /// A member of a map; `Null` where there is none.
    pub fn get(&self, name: &str) -> &Json {
        match self {
            Json::Map(map) => map.get(name).unwrap_or(&Json::Null),
            _ => &Json::Null,
        }
    }

    pub fn as_text(&self) -> &str {
        match self {
            Json::Text(text) => text,
            _ => "",
        }
    }
}

impl fmt::Display for Json {
    fn fmt(&self, out: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Json::Null => out.write_str("null"),
            Json::Bool(value) => write!(out, "{}", value),
            Json::Int(value) => write!(out, "{}", value),
            Json::Float(value) if value.is_nan() => out.write_str("\"NaN\""),
            Json::Float(value) if value.is_infinite() => out.write_str(if *value > 0.0 { "\"Infinity\"" } else { "\"-Infinity\"" }),
            Json::Float(value) => write!(out, "{:?}", value),
            Json::Text(text) => quote(out, text),
            Json::List(items) => {
                out.write_str("[")?;
                for (at, item) in items.iter().enumerate() {
                    write!(out, "{}{}", if at > 0 { "," } else { "" }, item)?;
                }
                out.write_str("]")
            }
            Json::Map(items) => {
                out.write_str("{")?;
                for (at, (name, item)) in items.iter().enumerate() {
                    out.write_str(if at > 0 { "," } else { "" })?;
                    quote(out, name)?;
                    write!(out, ":{}", item)?;
                }
                out.write_str("}")
            }
        }
    }
}

fn quote(out: &mut fmt::Formatter, text: &str) -> fmt::Result {
    out.write_str("\"")?;
    for letter in text.chars() {
        match letter {
            '"' => out.write_str("\\\"")?,
            '\\' => out.write_str("\\\\")?,
            letter if (letter as u32) < 0x20 => write!(out, "\\u{:04x}", letter as u32)?,
            letter => write!(out, "{}", letter)?,
        }
    }
    out.write_str("\"")
}

struct Parser<'a> {
    text: &'a [u8],
    at: usize,
    depth: usize,
}

impl<'a> Parser<'a> {
    fn fault(&self) -> Error {
        Error::local("bad_response", format!("no JSON at byte {}", self.at))
    }

    fn space(&mut self) {
        while self.at < self.text.len() && self.text[self.at].is_ascii_whitespace() {
            self.at += 1;
        }
    }

    fn take(&mut self, word: &str) -> bool {
        self.space();
        let there = self.text[self.at..].starts_with(word.as_bytes());
        if there {
            self.at += word.len();
        }
        there
    }

    fn value(&mut self) -> Result<Json, Error> {
        self.depth += 1;
        if self.depth > 128 {
            return Err(self.fault());
        }
        let value = if self.take("null") {
            Json::Null
        } else if self.take("true") {
            Json::Bool(true)
        } else if self.take("false") {
            Json::Bool(false)
        } else if self.take("\"") {
            Json::Text(self.string()?)
        } else if self.take("[") {
            let mut items = Vec::new();
            while !self.take("]") {
                if !items.is_empty() && !self.take(",") {
                    return Err(self.fault());
                }
                items.push(self.value()?);
            }
            Json::List(items)
        } else if self.take("{") {
            let mut items = BTreeMap::new();
            while !self.take("}") {
                if !items.is_empty() && !self.take(",") || !self.take("\"") {
                    return Err(self.fault());
                }
                let name = self.string()?;
                if !self.take(":") {
                    return Err(self.fault());
                }
                items.insert(name, self.value()?);
            }
            Json::Map(items)
        } else {
            self.number()?
        };
        self.depth -= 1;
        Ok(value)
    }

    fn number(&mut self) -> Result<Json, Error> {
        let begin = self.at;
        while self.at < self.text.len() && b"+-.0123456789eE".contains(&self.text[self.at]) {
            self.at += 1;
        }
        let text = std::str::from_utf8(&self.text[begin..self.at]).unwrap_or("");
        match (text.parse::<i64>(), text.parse::<f64>()) {
            (Ok(value), _) => Ok(Json::Int(value)),
            (_, Ok(value)) => Ok(Json::Float(value)),
            _ => Err(self.fault()),
        }
    }

    fn string(&mut self) -> Result<String, Error> {
        let mut made = Vec::new();
        loop {
            let letter = *self.text.get(self.at).ok_or_else(|| self.fault())?;
            self.at += 1;
            match letter {
                b'"' => return String::from_utf8(made).map_err(|_| self.fault()),
                b'\\' => {
                    let escaped = *self.text.get(self.at).ok_or_else(|| self.fault())?;
                    self.at += 1;
                    let letter = match escaped {
                        b'b' => '\u{8}',
                        b'f' => '\u{c}',
                        b'n' => '\n',
                        b'r' => '\r',
                        b't' => '\t',
                        b'u' => self.unicode()?,
                        other => other as char,
                    };
                    made.extend(letter.to_string().bytes());
                }
                letter => made.push(letter),
            }
        }
    }

    fn unicode(&mut self) -> Result<char, Error> {
        let first = self.hex()?;
        if (0xd800..0xdc00).contains(&first) && self.text[self.at..].starts_with(b"\\u") {
            self.at += 2;
            let second = self.hex()?;
            let code = 0x10000 + ((first - 0xd800) << 10) + second.wrapping_sub(0xdc00);
            return char::from_u32(code).ok_or_else(|| self.fault());
        }
        Ok(char::from_u32(first).unwrap_or('\u{fffd}'))
    }

    fn hex(&mut self) -> Result<u32, Error> {
        let digits = self.text.get(self.at..self.at + 4).ok_or_else(|| self.fault())?;
        self.at += 4;
        let text = std::str::from_utf8(digits).map_err(|_| self.fault())?;
        u32::from_str_radix(text, 16).map_err(|_| self.fault())
    }
}

/// What can be sent and received.
pub trait Value: Sized {
    fn to_json(&self) -> Json;
    fn from_json(json: &Json) -> Result<Self, Error>;
}

fn expected<T>(what: &str, found: &Json) -> Result<T, Error> {
    Err(Error::local("bad_response", format!("expected {}, found {}", what, found)))
}

impl Value for Json {
    fn to_json(&self) -> Json {
        self.clone()
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        Ok(json.clone())
    }
}

impl Value for bool {
    fn to_json(&self) -> Json {
        Json::Bool(*self)
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Bool(value) => Ok(*value),
            other => expected("true or false", other),
        }
    }
}

impl Value for i64 {
    fn to_json(&self) -> Json {
        Json::Int(*self)
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Int(value) => Ok(*value),
            Json::Text(digits) => digits.parse().or_else(|_| expected("an integer", json)),
            other => expected("an integer", other),
        }
    }
}

impl Value for u64 {
    fn to_json(&self) -> Json {
        i64::try_from(*self).map_or_else(|_| Json::Text(self.to_string()), Json::Int)
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Int(value) => u64::try_from(*value).or_else(|_| expected("an integer from 0", json)),
            Json::Text(digits) => digits.parse().or_else(|_| expected("an integer from 0", json)),
            other => expected("an integer from 0", other),
        }
    }
}

impl Value for f64 {
    fn to_json(&self) -> Json {
        Json::Float(*self)
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Float(value) => Ok(*value),
            Json::Int(value) => Ok(*value as f64),
            Json::Text(text) if text == "NaN" => Ok(f64::NAN),
            Json::Text(text) if text == "Infinity" => Ok(f64::INFINITY),
            Json::Text(text) if text == "-Infinity" => Ok(f64::NEG_INFINITY),
            other => expected("a number", other),
        }
    }
}

impl Value for String {
    fn to_json(&self) -> Json {
        Json::Text(self.clone())
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Text(text) => Ok(text.clone()),
            other => expected("a text", other),
        }
    }
}

impl Value for () {
    fn to_json(&self) -> Json {
        Json::Null
    }
    fn from_json(_: &Json) -> Result<Self, Error> {
        Ok(())
    }
}

const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

impl Value for Base64 {
    fn to_json(&self) -> Json {
        let mut text = String::new();
        for group in self.0.chunks(3) {
            let bits = group.iter().fold(0u32, |all, byte| all << 8 | *byte as u32) << (8 * (3 - group.len()));
            for at in 0..4 {
                let digit = DIGITS[(bits >> (18 - 6 * at) & 63) as usize] as char;
                text.push(if at > group.len() { '=' } else { digit });
            }
        }
        Json::Text(text)
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        let (mut made, mut bits, mut held) = (Vec::new(), 0u32, 0);
        for letter in json.as_text().bytes().filter(|letter| *letter != b'=') {
            let digit = DIGITS.iter().position(|known| *known == letter);
            bits = bits << 6 | digit.ok_or_else(|| Error::local("bad_response", "no base64".into()))? as u32;
            held += 6;
            if held >= 8 {
                held -= 8;
                made.push((bits >> held) as u8);
            }
        }
        Ok(Base64(made))
    }
}

impl<T: Value> Value for Option<T> {
    fn to_json(&self) -> Json {
        self.as_ref().map_or(Json::Null, |value| value.to_json())
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Null => Ok(None),
            other => T::from_json(other).map(Some),
        }
    }
}

impl<T: Value> Value for Box<T> {
    fn to_json(&self) -> Json {
        (**self).to_json()
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        T::from_json(json).map(Box::new)
    }
}

impl<T: Value> Value for Vec<T> {
    fn to_json(&self) -> Json {
        Json::List(self.iter().map(|item| item.to_json()).collect())
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::List(items) => items.iter().map(T::from_json).collect(),
            other => expected("a list", other),
        }
    }
}

impl<T: Value> Value for BTreeMap<String, T> {
    fn to_json(&self) -> Json {
        Json::Map(self.iter().map(|(name, item)| (name.clone(), item.to_json())).collect())
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Map(items) => items.iter().map(|(name, item)| Ok((name.clone(), T::from_json(item)?))).collect(),
            other => expected("a map", other),
        }
    }
}

/// What the gateway refused or failed to do; `connection_lost` and `bad_response` are found here.
#[derive(Clone, Debug)]
pub struct Error {
    pub code: String,
    pub message: String,
    pub remedy: String,
    pub retryable: bool,
    /// The command that has ended with it; empty where none had begun.
    pub command: String,
}

impl Error {
    fn local(code: &str, message: String) -> Error {
        let retryable = code == "connection_lost";
        Error { code: code.into(), message, remedy: String::new(), retryable, command: String::new() }
    }
}

impl From<io::Error> for Error {
    fn from(error: io::Error) -> Error {
        Error::local("connection_lost", error.to_string())
    }
}

impl fmt::Display for Error {
    fn fmt(&self, out: &mut fmt::Formatter) -> fmt::Result {
        write!(out, "{}: {}", self.code, self.message)
    }
}

impl std::error::Error for Error {}

const POLL: Duration = Duration::from_millis(200);
const ATTEMPT: Duration = Duration::from_secs(10);
const PATIENCE: Duration = Duration::from_secs(30);
const SILENCE: Duration = Duration::from_secs(45); // the gateway sends a comment every 15 s
const FIRST_PAUSE: Duration = Duration::from_millis(250);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);

/// A gateway, over HTTP and server-sent events without TLS: for one on this machine, or behind a proxy here.
pub struct Gateway {
    host: String,
    token: String,
}

/// A response, whose body is read as it comes.
struct Reply {
    status: u16,
    body: BufReader<Box<dyn Read>>,
}

/// The pieces of a body as one, up to the last.
struct Chunks {
    inner: BufReader<TcpStream>,
    left: usize,
    over: bool,
}

impl Read for Chunks {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if self.left == 0 && !self.over {
            let mut line = String::new();
            while line.trim().is_empty() {
                line.clear();
                if self.inner.read_line(&mut line)? == 0 {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
            }
            let size = line.trim().split(';').next().unwrap_or("");
            self.left = usize::from_str_radix(size, 16).map_err(|_| io::Error::from(io::ErrorKind::InvalidData))?;
            self.over = self.left == 0;
        }
        let most = into.len().min(self.left);
        let size = self.inner.read(&mut into[..most])?;
        if size == 0 && most > 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        self.left -= size;
        Ok(size)
    }
}

impl Gateway {
    /// Nothing is sent yet. The token may be empty.
    pub fn new(url: &str, token: &str) -> Result<Gateway, Error> {
        match url.strip_prefix("http://") {
            Some(host) => Ok(Gateway { host: host.trim_end_matches('/').into(), token: token.into() }),
            None => Err(Error::local("bad_request", format!("the address has to begin with http://, not {}", url))),
        }
    }

    fn connect(&self) -> io::Result<TcpStream> {
        let mut outcome = Err(io::Error::from(io::ErrorKind::NotFound));
        for address in self.host.to_socket_addrs()? {
            outcome = TcpStream::connect_timeout(&address, ATTEMPT);
            if outcome.is_ok() {
                break;
            }
        }
        outcome
    }

    fn open(&self, method: &str, path: &str, body: Option<&Json>, header: &str, silence: Duration) -> Result<Reply, Error> {
        let mut stream = self.connect()?;
        stream.set_read_timeout(Some(silence))?;
        stream.set_write_timeout(Some(ATTEMPT))?;
        let body = body.map_or(String::new(), |body| body.to_string());
        let mut head = format!("{} /rcp/v1{} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n{}", method, path, self.host, header);
        if !self.token.is_empty() {
            head += &format!("Authorization: Bearer {}\r\n", self.token);
        }
        if !body.is_empty() {
            head += &format!("Content-Type: application/json\r\nContent-Length: {}\r\n", body.len());
        }
        stream.write_all(format!("{}\r\n{}", head, body).as_bytes())?;
        let mut lines = BufReader::new(stream);
        let mut line = String::new();
        lines.read_line(&mut line)?;
        let status = line.split(' ').nth(1).and_then(|code| code.parse().ok());
        let status = status.ok_or_else(|| Error::local("connection_lost", "the connection was closed".into()))?;
        let (mut size, mut chunked) = (0, false);
        loop {
            line.clear();
            if lines.read_line(&mut line)? == 0 {
                return Err(Error::local("connection_lost", "the connection was closed".into()));
            }
            let lower = line.trim().to_ascii_lowercase();
            if lower.is_empty() {
                break;
            } else if let Some(length) = lower.strip_prefix("content-length:") {
                size = length.trim().parse().unwrap_or(0);
            } else if lower.starts_with("transfer-encoding:") {
                chunked = true;
            }
        }
        let body: Box<dyn Read> = if chunked {
            Box::new(Chunks { inner: lines, left: 0, over: false })
        } else {
            Box::new(lines.take(size))
        };
        Ok(Reply { status, body: BufReader::new(body) })
    }

    fn ask(&self, method: &str, path: &str, body: Option<&Json>, header: &str) -> Result<Json, Error> {
        decoded(self.open(method, path, body, header, ATTEMPT)?)
    }

    /// Ask again while no answer comes. What may have begun is not refused by a refusal that passes: `begun` says that
    /// it may have before, and each request that is lost says so too.
    fn insist(&self, method: &str, path: &str, body: Option<&Json>, header: &str, begun: bool) -> Result<Json, Error> {
        let (end, mut lost) = (Instant::now() + PATIENCE, None);
        loop {
            match self.ask(method, path, body, header) {
                Err(error) if error.code == "connection_lost" => lost = Some(error),
                Err(error) if error.retryable && error.command.is_empty() && (begun || lost.is_some()) => {
                    if Instant::now() >= end {
                        return Err(lost.unwrap_or(error));
                    }
                }
                outcome => return outcome,
            }
            match lost {
                Some(error) if Instant::now() >= end => return Err(error),
                _ => sleep(POLL),
            }
        }
    }
}

fn decoded(mut reply: Reply) -> Result<Json, Error> {
    let mut text = String::new();
    reply.body.read_to_string(&mut text)?;
    let found = Json::parse(&text).map_err(|_| Error::local("connection_lost", "the answer was cut off".into()))?;
    match found.get("error") {
        Json::Null => Ok(found),
        error => Err(failure(error, found.get("command"))),
    }
}

fn failure(error: &Json, command: &Json) -> Error {
    Error {
        command: command.as_text().into(),
        code: error.get("code").as_text().into(),
        message: error.get("message").as_text().into(),
        remedy: error.get("remedy").as_text().into(),
        retryable: error.get("retryable") == &Json::Bool(true),
    }
}

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
        T::from_json(gateway.insist("GET", &format!("/context{}", self.path), None, "", false)?.get("body"))
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
        let mut path = format!("/context{}", self.path);
        if let Some(time) = valid_for {
            path += &format!("?valid_for={}", time.as_secs_f64());
        }
        gateway.ask("PUT", &path, Some(&value.to_json()), "").map(|_| ())
    }
}

/// A path that can be read, watched and written.
pub struct Setting<R, W> {
    pub get: Readable<R>,
    pub set: Writable<W>,
}

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
"""
