//! Request bodies: read within bounds before anything else, so that even a refused client sees its response, then
//! parsed as JSON whatever the Content-Type.

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body as Stream, Bytes};
use axum::http::HeaderMap;
use axum::http::header::{CONTENT_ENCODING, CONTENT_LENGTH, EXPECT};
use http_body_util::{BodyExt, LengthLimitError, Limited};
use tokio::time::timeout;

use crate::connections::admission::{ConnectionPermit, HeldBytes};
use crate::operations::parameters::json::{MAX_BODY_BYTES, MAX_OVERSIZED_BYTES};
use crate::operations::{Code, Problem};

/// Time in which a body must arrive: [`MAX_BODY_BYTES`] at 64 kbit/s, and a little more.
pub const BODY_TIME: Duration = Duration::from_secs(10);

/// A body, and the count of the bytes it holds for its connection.
pub type HeldBody = (Bytes, Option<HeldBytes>);

/// Reads a body, within the bounds above.
pub async fn read(stream: Stream, permit: Option<&Arc<ConnectionPermit>>) -> Result<HeldBody, Problem> {
    match timeout(BODY_TIME, collect(stream, permit)).await {
        Ok(read) => read,
        Err(_) => Err(Problem::new(Code::RequestTimeout, format!("the body did not arrive within {BODY_TIME:?}"))),
    }
}

async fn collect(mut stream: Stream, permit: Option<&Arc<ConnectionPermit>>) -> Result<HeldBody, Problem> {
    let mut held = permit.map(ConnectionPermit::held);
    let mut read = 0;
    let counted = (&mut stream).map_frame(|frame| {
        read += frame.data_ref().map_or(0, Bytes::len);
        if let Some(held) = &mut held {
            held.set(read);
        }
        frame
    });
    match Limited::new(counted, MAX_BODY_BYTES).collect().await {
        Ok(collected) => Ok((collected.to_bytes(), held)),
        Err(error) if error.is::<LengthLimitError>() => {
            drain(stream).await;
            Err(too_large())
        }
        Err(error) => Err(Problem::new(Code::Malformed, format!("the body could not be read: {error}"))),
    }
}

fn too_large() -> Problem {
    let detail = format!("the body is larger than {MAX_BODY_BYTES} bytes");
    Problem::new(Code::TooLarge, detail).limits(None, Some(MAX_BODY_BYTES.into()))
}

/// Refuses a body that is too large before the client sends it, if the client waits for `100 Continue` (RFC 9110, 10.1.1).
pub fn check_announced(headers: &HeaderMap) -> Result<(), Problem> {
    let waits = headers.get(EXPECT).is_some_and(|value| value.as_bytes().eq_ignore_ascii_case(b"100-continue"));
    let length = headers.get(CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
    let is_too_large = length.is_some_and(|length| length > MAX_BODY_BYTES as u64);
    if waits && is_too_large { Err(too_large()) } else { Ok(()) }
}

/// Refuses a compressed body, which would be read as JSON.
pub fn check_encoding(headers: &HeaderMap, body: &Bytes) -> Result<(), Problem> {
    let mut encodings = headers.get_all(CONTENT_ENCODING).iter();
    if body.is_empty() || encodings.all(|value| value.as_bytes().eq_ignore_ascii_case(b"identity")) {
        return Ok(());
    }
    Err(Problem::new(Code::UnsupportedEncoding, "the body has a Content-Encoding: send it uncompressed"))
}

/// Returns the bytes of a body, which may have been read already.
pub async fn bytes(stream: Stream) -> Result<Bytes, Problem> {
    read(stream, None).await.map(|(bytes, _)| bytes)
}

/// Reads and discards the rest of a body, within the bounds above.
pub async fn drain(mut stream: Stream) {
    let read = async {
        let mut bytes = 0;
        while let Some(Ok(frame)) = stream.frame().await {
            bytes += frame.data_ref().map_or(0, Bytes::len);
            if bytes > MAX_OVERSIZED_BYTES {
                break;
            }
        }
    };
    // A timeout does not change the response.
    let _ = timeout(BODY_TIME, read).await;
}
