//! Token and position embeddings.

use super::check::{as_u32, expect_len, expect_multiple, shape_error};
use crate::error::KernelError;
use crate::registry::nn::embedding_gather;
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "nn/embedding";

/// The two tables of an embedding.
#[derive(Clone, Copy, Debug)]
pub struct Tables<'a> {
    /// Token embeddings `[vocab, width]`.
    pub table: &'a Buffer<f32>,
    /// Position embeddings `[max_tokens, width]`.
    pub position: &'a Buffer<f32>,
    /// Elements of a row, a multiple of 4.
    pub width: usize,
}

/// `y[r] = table[ids[r]] + position[r mod tokens]`.
///
/// # Shapes
/// in `ids` \[rows\], rows a multiple of `tokens`, every id below vocab (the caller checks; a larger one reads the last
/// row) · [`Tables`] · out `y` \[rows, width\] (=)
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn gather(
    rec: &mut Recorder,
    tables: &Tables,
    ids: &Buffer<u32>,
    tokens: usize,
    y: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let Tables { table, position, width } = *tables;
    expect_multiple(KERNEL, "width", width, 4)?;
    expect_multiple(KERNEL, "table", table.len(), width)?;
    let rows = ids.len();
    if rows > 0 {
        expect_multiple(KERNEL, "ids", rows, tokens.max(1))?;
    }
    expect_len(KERNEL, "y", y.len(), rows * width, "rows*width")?;
    if tokens * width > position.len() {
        let got = format!("[{}]", position.len());
        return Err(shape_error(KERNEL, "position", got, format!("at least [{tokens}, {width}]")));
    }
    let params = embedding_gather::Params {
        rows: as_u32(rows),
        tokens: as_u32(tokens),
        width: as_u32(width),
        vocab: as_u32(table.len() / width),
    };
    let bind = embedding_gather::Bind { ids, table_tex: table, position_tex: position, y };
    rec.dispatch(bind, params, Grid::threads(rows * width / 4))
}
