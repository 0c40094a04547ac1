//! Identification of a device: 50h and 51h, then 07h, so that a device on TCP does not go into FAST STOP.

use std::fmt;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::timeout;

use crate::transport::Pipe;
use crate::wsg::frame::encode_with;
use crate::wsg::{ChecksumEvaluation, Command, Data, Decoded, Decoder, Reply, Status, SystemInfo, id};

/// Size of a read in bytes.
const READ_BYTES: usize = 256;

/// A device's description of itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct DeviceIdentity {
    info: SystemInfo,
    tag: Option<String>,
}

impl fmt::Display for DeviceIdentity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let SystemInfo { device_type, firmware, serial_number, .. } = self.info;
        write!(f, "{device_type}, serial number {serial_number}, firmware {firmware}")?;
        self.tag.as_ref().filter(|tag| !tag.is_empty()).map_or(Ok(()), |tag| write!(f, ", tag {tag:?}"))
    }
}

/// Result of an identification.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Identification {
    Device(DeviceIdentity),
    /// A WSG device that refuses the request.
    Status(Status),
    /// Bytes, but no frame.
    Garbage,
    Silence,
    /// The connection ended.
    Closed(String),
}

impl Identification {
    /// Whether a WSG device answered.
    pub(super) fn is_device(&self) -> bool {
        matches!(self, Self::Device(_) | Self::Status(_))
    }
}

struct Conversation {
    pipe: Pipe,
    decoder: Decoder,
    wait: Duration,
}

/// Identifies the device behind a pipe. Waits up to `wait` for each reply, and for the end of the connection if the
/// device notices it.
pub(super) async fn identify(pipe: Pipe, is_connection: bool, wait: Duration) -> Identification {
    let decoder = Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On);
    let mut conversation = Conversation { pipe, decoder, wait };
    let identification = match conversation.ask(&Command::GetSystemInfo).await {
        Ok(Reply::Success(Data::SystemInfo(info))) => {
            let tag = match conversation.ask(&Command::GetDeviceTag).await {
                Ok(Reply::Success(Data::DeviceTag(tag))) => Some(tag.text()),
                _ => None,
            };
            Identification::Device(DeviceIdentity { info, tag })
        }
        Ok(reply) => Identification::Status(reply.status()),
        Err(failure) => failure,
    };
    if is_connection && !matches!(identification, Identification::Closed(_)) {
        // The device closes the connection after its reply.
        let _ = conversation.ask(&Command::DisconnectAnnouncement).await;
    }
    identification
}

impl Conversation {
    /// Sends a request, and waits for its reply.
    async fn ask(&mut self, command: &Command) -> Result<Reply, Identification> {
        let mut frame = Vec::new();
        encode_with(command.id(), &mut frame, |out| command.write_payload(out));
        let writer = &mut self.pipe.writer;
        let sent = async {
            writer.write_all(&frame).await?;
            writer.flush().await
        };
        sent.await.map_err(|error| Identification::Closed(error.to_string()))?;
        let wait = self.wait;
        match timeout(wait, self.reply(command.id())).await {
            Ok(reply) => reply,
            Err(_) if self.decoder.counters().bytes > 0 && self.decoder.counters().frames == 0 => {
                Err(Identification::Garbage)
            }
            Err(_) => Err(Identification::Silence),
        }
    }

    /// Reads until the reply arrives. Skips automatic updates.
    async fn reply(&mut self, id: u8) -> Result<Reply, Identification> {
        let mut bytes = [0; READ_BYTES];
        loop {
            while let Some(decoded) = self.decoder.next() {
                if let Decoded::Frame(frame) = decoded
                    && frame.id == id
                    && let Ok(reply) = Reply::parse(id, frame.payload)
                {
                    return Ok(reply);
                }
            }
            match self.pipe.reader.read(&mut bytes).await {
                Ok(0) => return Err(Identification::Closed("the device closed the connection".to_owned())),
                Ok(count) => self.decoder.push(&bytes[..count]),
                Err(error) => return Err(Identification::Closed(error.to_string())),
            }
        }
    }
}
