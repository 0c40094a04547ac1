//! HTTP over plain sockets, without a client library that would keep connections or retry.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

/// Time limit of a connect, and of each read and write.
pub const PATIENCE: Duration = Duration::from_secs(2);

#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub body: String,
}

pub fn connect(address: SocketAddr) -> std::io::Result<TcpStream> {
    let stream = TcpStream::connect_timeout(&address, PATIENCE)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    Ok(stream)
}

/// Encodes a request.
pub fn request(method: &str, path: &str, body: &str) -> String {
    let length = body.len();
    format!("{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {length}\r\n\r\n{body}")
}

/// Reads an answer, or returns `None` if the connection ends first.
pub fn read_answer(stream: &mut TcpStream) -> Option<Answer> {
    let (mut received, mut buffer) = (Vec::new(), [0; 4096]);
    loop {
        if let Some(answer) = whole(&received) {
            return Some(answer);
        }
        match stream.read(&mut buffer) {
            Ok(0) | Err(_) => return None,
            Ok(bytes) => received.extend_from_slice(&buffer[..bytes]),
        }
    }
}

fn whole(received: &[u8]) -> Option<Answer> {
    let text = String::from_utf8_lossy(received);
    let (head, body) = text.split_once("\r\n\r\n")?;
    let mut lines = head.lines();
    let status = lines.next()?.split(' ').nth(1)?.parse().ok()?;
    let length = lines.find_map(|line| line.to_ascii_lowercase().strip_prefix("content-length: ")?.parse().ok());
    (body.len() >= length.unwrap_or(0)).then(|| Answer { status, body: body.to_owned() })
}

/// Sends a request, and reads its answer.
pub fn ask(stream: &mut TcpStream, request: &str) -> Option<Answer> {
    stream.write_all(request.as_bytes()).ok()?;
    read_answer(stream)
}

pub fn get(address: SocketAddr, path: &str) -> Option<Answer> {
    ask(&mut connect(address).ok()?, &request("GET", path, ""))
}

pub fn post(address: SocketAddr, path: &str, body: &str) -> Option<Answer> {
    ask(&mut connect(address).ok()?, &request("POST", path, body))
}
