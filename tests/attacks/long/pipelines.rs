//! Pipelined requests.

use std::io;
use std::sync::Arc;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::attack::{self, MANY};
use crate::attacker::{Attacker, Crowd};
use crate::device::Device;
use crate::gateway::{Gateway, Limits};
use crate::http;

const CONNECTIONS: usize = 64;
const IN_A_ROW: usize = 500;

/// Sends batches of state requests without waiting for answers, and reads the answers.
pub async fn pipeline(crowd: Arc<Crowd>, _: usize, stream: TcpStream) -> io::Result<()> {
    let requests = http::request("GET", "/api/v1/grippers/g/state", "").repeat(IN_A_ROW);
    let (mut reader, mut writer) = stream.into_split();
    let _inside = crowd.inside();
    let read = async {
        let mut buffer = [0; 16 * 1024];
        while reader.read(&mut buffer).await? > 0 {}
        Ok(())
    };
    let write = async {
        loop {
            writer.write_all(requests.as_bytes()).await?;
            crowd.sent(IN_A_ROW);
        }
    };
    tokio::select! {
        ended = read => ended,
        ended = write => ended,
    }
}

#[test]
fn pipelined_requests_block_no_client() {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let begin = || Attacker::start("pipelines", CONNECTIONS, gateway.address);
    let row = attack::run("64 x 500 pipelined GETs", MANY, (&gateway, &g), begin, |attacker, _| {
        println!("pipelines: {:?}", attacker.done());
    });
    row.blocks_no_client();
}
