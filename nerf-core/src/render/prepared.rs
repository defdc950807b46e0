//! A scene's values as a kernel takes them: read in place from the blob, or unpacked and decoded once.

use super::stages::Proposer;
use crate::blob::{Blob, BlobError, StoredTables};
use crate::encoding::{GridTables, TableValues};
use crate::matrix::Kernel;
use crate::memory::Layout;
use crate::network::{Network, Weights, unpack};

/// The values of a scene that a kernel does not read in place from the blob.
///
/// `F` and `B` are numbers of values, slices of the caller's memory, or boxes; empty for values that are read in
/// place.
#[derive(Clone, Debug)]
pub(crate) struct Prepared<F, B> {
    /// f32: the network's parameters, those of the proposal network, and f16 tables.
    pub unpacked: [F; 3],
    /// Signed bytes: coded tables.
    pub decoded: B,
}

impl Prepared<usize, usize> {
    /// Numbers of values that `kernel` needs of a scene.
    #[inline]
    pub fn measure(blob: &Blob<'_>, kernel: Kernel) -> Self {
        let unpacked = match kernel.storage.in_place() {
            true => [0; 3],
            false => [
                blob.architecture().parameters(),
                Proposer::parameters(blob),
                widened_tables(blob, kernel).map_or(0, |bytes| bytes.len() / 2),
            ],
        };
        Self { unpacked, decoded: blob.decoded_len() }
    }
}

impl<'a> Prepared<&'a mut [f32], &'a mut [u8]> {
    /// Memory for the values that `kernel` needs of a scene.
    #[inline]
    pub fn lay_out(layout: &mut impl Layout<'a>, blob: &Blob<'_>, kernel: Kernel) -> Self {
        let Prepared { unpacked, decoded } = Prepared::measure(blob, kernel);
        let unpacked = match kernel.storage.in_place() {
            true => [&mut [][..], &mut [], &mut []],
            false => unpacked.map(|count| layout.slice(count, 0.0)),
        };
        Self { unpacked, decoded: layout.slice(decoded, 0) }
    }
}

impl<F: AsMut<[f32]>, B: AsMut<[u8]>> Prepared<F, B> {
    /// Unpacks and decodes the values of a scene, once.
    ///
    /// # Errors
    /// [`BlobError`] of coded tables in a blob that was opened undecoded.
    #[inline]
    pub fn unpack(&mut self, blob: &Blob<'_>, kernel: Kernel) -> Result<(), BlobError> {
        if !kernel.storage.in_place() {
            let [parameters, proposal, tables] = self.unpacked.each_mut().map(AsMut::as_mut);
            Weights::unpack(blob.architecture(), kernel.storage, blob.weights(), parameters);
            Proposer::unpack(blob, kernel.storage, proposal);
            if let Some(bytes) = widened_tables(blob, kernel) {
                unpack(bytes, tables);
            }
        }
        blob.decode_tables(self.decoded.as_mut())
    }
}

impl<'a> Prepared<&'a [f32], &'a [u8]> {
    /// The scene's network and its proposal network, over their values in the blob or in `self`; `None` if there are
    /// too few.
    #[inline]
    pub(super) fn view(&self, blob: &Blob<'a>, kernel: Kernel) -> Option<(Network<'a>, Proposer<'a>)> {
        let [parameters, proposal, tables] = self.unpacked;
        let weights = Weights::view(blob.architecture(), kernel.storage, blob.weights(), parameters);
        let tables = tables_of(blob, kernel, tables, self.decoded);
        let network = Network::of_layers(blob.architecture(), blob.layers(), weights, tables, kernel.isa)?;
        Some((network, Proposer::view(blob, kernel, proposal)))
    }
}

/// The tables of a scene's grid: in place in the blob, or as f32 (`widened`) or bytes (`decoded`) made from them.
pub(super) fn tables_of<'a>(
    blob: &Blob<'a>,
    kernel: Kernel,
    widened: &'a [f32],
    decoded: &'a [u8],
) -> GridTables<'a> {
    let values = match blob.tables() {
        None => TableValues::F32(&[]),
        Some(StoredTables::F16(_)) if widened_tables(blob, kernel).is_some() => TableValues::F32(widened),
        Some(StoredTables::F16(bytes)) => TableValues::F16(bytes),
        Some(StoredTables::Int8 { scales, bytes }) => TableValues::Int8 { values: bytes, scales },
        Some(StoredTables::Coded { scales, .. }) => TableValues::Int8 { values: decoded, scales },
    };
    GridTables::new(values, blob.scene_box().as_ref())
}

/// The blob's f16 tables, if the kernel does not read them in place.
fn widened_tables<'a>(blob: &Blob<'a>, kernel: Kernel) -> Option<&'a [u8]> {
    match blob.tables() {
        Some(StoredTables::F16(bytes)) if !(kernel.storage.in_place() || kernel.isa.reads_f16_tables()) => {
            Some(bytes)
        }
        _ => None,
    }
}
