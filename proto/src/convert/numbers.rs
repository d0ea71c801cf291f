//! Columns of f32 as packed little-endian bytes.

use crate::WireError;
use bytes::Bytes;

#[cfg(target_endian = "big")]
compile_error!("columns travel little-endian and are copied as they are");

/// The bytes of a column.
pub(crate) fn to_bytes(numbers: &[f32]) -> Bytes {
    Bytes::copy_from_slice(bytemuck::cast_slice(numbers))
}

/// The column in `bytes`, copied, so that the receive buffer is not kept alive.
pub(super) fn from_bytes(field: &'static str, bytes: &[u8], expected: usize) -> Result<Vec<f32>, WireError> {
    let mut numbers = Vec::new();
    fill_from_bytes(&mut numbers, field, bytes, expected)?;
    Ok(numbers)
}

/// The same in place of what `numbers` holds.
pub(super) fn fill_from_bytes(
    numbers: &mut Vec<f32>,
    field: &'static str,
    bytes: &[u8],
    expected: usize,
) -> Result<(), WireError> {
    if bytes.len() != expected * size_of::<f32>() {
        let expected = format!("{} ({expected} numbers)", expected * size_of::<f32>());
        return Err(WireError::invalid(field, format!("{} bytes", bytes.len()), expected));
    }
    // Not `pod_collect_to_vec`, which writes every number twice.
    numbers.clear();
    numbers.extend(bytes.as_chunks().0.iter().map(|four| f32::from_le_bytes(*four)));
    Ok(())
}
