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
use std::ops::Deref;
use std::sync::{Arc, Condvar, Mutex};
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};
