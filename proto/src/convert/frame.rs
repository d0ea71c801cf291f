//! A message as it stands in the body of a gRPC call, for whoever sends the same bytes to many.

use bytes::{BufMut, Bytes, BytesMut};
use prost::Message;

/// Not compressed, the length, the message.
pub fn grpc_frame(message: &impl Message) -> Bytes {
    let length = message.encoded_len();
    let mut frame = BytesMut::with_capacity(5 + length);
    frame.put_u8(0);
    frame.put_u32(length as u32);
    message.encode(&mut frame).expect("a buffer that grows has room");
    frame.freeze()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v1;

    #[test]
    fn a_frame_is_a_length_and_a_message() {
        let message = v1::Committed { episode: 300 };
        let frame = grpc_frame(&message);
        assert_eq!(frame[..5], [0, 0, 0, 0, 3]);
        assert_eq!(v1::Committed::decode(&frame[5..]), Ok(message));
    }
}
