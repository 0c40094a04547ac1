//! A relay between gateway and device that notes the time of each FAST STOP frame.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::spawn;
use std::time::Instant;

use wsg_gateway::wsg::{ChecksumEvaluation, Decoded, Decoder, id};

use crate::program::Error;

/// Relays between one gateway and a device.
pub fn start(device: String) -> Result<(SocketAddr, Receiver<Instant>), Error> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let (address, (stops, stopped)) = (listener.local_addr()?, channel());
    spawn(move || -> Result<(), Error> {
        let (gateway, device) = (listener.accept()?.0, TcpStream::connect(device)?);
        for stream in [&gateway, &device] {
            stream.set_nodelay(true)?;
        }
        let back = (device.try_clone()?, gateway.try_clone()?);
        spawn(move || pass(back.0, back.1, None));
        pass(gateway, device, Some(&stops))
    });
    Ok((address, stopped))
}

fn pass(mut from: TcpStream, mut to: TcpStream, stops: Option<&Sender<Instant>>) -> Result<(), Error> {
    let mut decoder = Decoder::new(id::max_request_bytes, ChecksumEvaluation::On);
    let mut bytes = [0; 4096];
    loop {
        let read = from.read(&mut bytes)?;
        let now = Instant::now();
        if read == 0 {
            return Ok(());
        }
        to.write_all(&bytes[..read])?;
        let Some(stops) = stops else { continue };
        decoder.push(&bytes[..read]);
        while let Some(decoded) = decoder.next() {
            if matches!(decoded, Decoded::Frame(frame) if frame.id == id::FAST_STOP) {
                stops.send(now)?;
            }
        }
    }
}
