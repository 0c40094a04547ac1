//! Fuzz target of Modbus TCP.

use std::time::Instant;

use bytes::{Bytes, BytesMut};
use tokio_util::codec::Decoder as _;

use super::adu::{self, Header, NotModbus};
use super::image::Image;
use super::registers::FAST_STOP_AT;

/// Checks that the requests do not depend on how the stream is split, and that no write of a FAST STOP is lost. The first
/// byte is the length of a piece.
pub(crate) fn stream(data: &[u8]) {
    let Some((&piece, stream)) = data.split_first() else { return };
    let whole = requests(stream, stream.len());
    assert_eq!(whole, requests(stream, piece.into()), "split into pieces of {piece} bytes");
    let now = Instant::now();
    let mut image = Image::new(now);
    for (_, request) in whole.into_iter().flatten() {
        let Some((address, words)) = adu::written(request) else { continue };
        let before = fast_stop_of(&image);
        let written = image.write(now, address, &words);
        if before == 0 && fast_stop_of(&image) != 0 {
            assert!(written.is_ok_and(|written| written.fast_stop), "a FAST STOP was lost");
        }
    }
}

fn fast_stop_of(image: &Image) -> u16 {
    image.outputs().get(FAST_STOP_AT).unwrap_or_default()
}

fn requests(stream: &[u8], in_pieces_of: usize) -> Vec<Result<(Header, Bytes), NotModbus>> {
    let mut codec = adu::frames();
    let mut buffer = BytesMut::new();
    let mut requests = Vec::new();
    for piece in stream.chunks(in_pieces_of.max(1)) {
        buffer.extend_from_slice(piece);
        loop {
            match codec.decode(&mut buffer) {
                Ok(Some(frame)) => requests.push(adu::parse(frame.freeze())),
                Ok(None) => break,
                // The connection is closed.
                Err(_) => return requests,
            }
        }
    }
    requests
}
