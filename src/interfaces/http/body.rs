//! Request bodies: read within bounds before anything else, so that even a refused client sees its response, then
//! parsed as JSON whatever the Content-Type.

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body as Stream, Bytes};
use http_body_util::{BodyExt, LengthLimitError, Limited};
use tokio::time::timeout;

use crate::interfaces::admission::{ConnectionPermit, HeldBytes};
use crate::operations::json::{MAX_BODY_BYTES, MAX_OVERSIZED_BYTES};
use crate::operations::{Code, Problem};

/// Time in which a body must arrive: [`MAX_BODY_BYTES`] at 64 kbit/s, and a little more.
pub const BODY_TIME: Duration = Duration::from_secs(10);

/// A body, and the count of the bytes it holds for its connection.
pub type HeldBody = (Bytes, Option<HeldBytes>);

/// Reads a body, within the bounds above.
pub async fn read(stream: Stream, permit: Option<&Arc<ConnectionPermit>>) -> Result<HeldBody, Problem> {
    let too_late = || Problem::new(Code::RequestTimeout, format!("the body did not arrive within {BODY_TIME:?}"));
    timeout(BODY_TIME, collect(stream, permit)).await.map_err(|_| too_late())?
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
            let detail = format!("the body is larger than {MAX_BODY_BYTES} bytes");
            Err(Problem::new(Code::TooLarge, detail).limits(None, Some(MAX_BODY_BYTES.into())))
        }
        Err(error) => Err(Problem::new(Code::Malformed, format!("the body could not be read: {error}"))),
    }
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
