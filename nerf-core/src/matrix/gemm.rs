//! The matrix product `C = init + A B`, which evaluates dense layers with f32 weights, forward and backward.

use crate::simd::{Isa, Lanes, Op};

/// Sizes and strides of one product `C = init + A B`, in elements.
#[derive(Clone, Copy, Debug)]
pub struct Gemm {
    /// Number of rows of A and of C.
    pub m: usize,
    /// Number of columns of B and of C. [`gemm`] requires a multiple of [`Isa::columns`].
    pub n: usize,
    /// Number of columns of A and of rows of B.
    pub k: usize,
    /// Distance from `A[i][p]` to `A[i+1][p]`, elements.
    pub a_row: usize,
    /// Distance from `A[i][p]` to `A[i][p+1]`, elements; 1 if A is row-major.
    pub a_col: usize,
    /// Distance from row `B[p]` to row `B[p+1]`, elements; the elements of a row are contiguous.
    pub b_row: usize,
    /// Distance from row `C[i]` to row `C[i+1]`, elements; the elements of a row are contiguous.
    pub c_row: usize,
}

/// Start values of the sums in a product `C = init + A B`.
#[derive(Clone, Copy, Debug)]
pub enum Init<'a, T = f32> {
    /// Every sum starts from 0.
    #[cfg_attr(not(any(feature = "normals", feature = "train")), allow(dead_code, reason = "of gradients"))]
    Zero,
    /// Every sum in row `i` of C starts from bias `i`. The slice holds one bias per row of C: f32, or the bytes of
    /// little-endian f16.
    Bias(&'a [T]),
    /// Every sum starts from the present element of C.
    Accumulate,
}

impl<'a, T> Init<'a, T> {
    /// Returns the start of a product's sums: the content of C if `accumulate`, else the bias.
    pub fn bias_unless(accumulate: bool, bias: &'a [T]) -> Self {
        if accumulate { Self::Accumulate } else { Self::Bias(bias) }
    }

    /// Returns the start of a product's sums: the content of C if `accumulate`, else 0.
    #[cfg(feature = "normals")]
    pub fn zero_unless(accumulate: bool) -> Self {
        if accumulate { Self::Accumulate } else { Self::Zero }
    }
}

/// Computes `C[i][j] = act(init + Σ_p A[i][p] B[p][j])`, summed in ascending `p`. `act`: ReLU if `relu`, else identity.
///
/// Every element is summed in the same order for any `m` and `n`: results do not depend on how a block of samples is
/// split into calls. Two instruction sets can give different results: only some fuse multiply-adds. ReLU of NaN is NaN.
///
/// # Panics
/// If `n` is no multiple of [`Isa::columns`], or if a slice is too short for the sizes and strides in `g`.
pub fn gemm(isa: Isa, g: Gemm, a: &[f32], b: &[f32], c: &mut [f32], init: Init<'_>, relu: bool) {
    if g.m == 0 || g.n == 0 {
        return;
    }
    assert!(isa.fills(g.n), "gemm: n is a multiple of {}", isa.columns());
    let (last_row, last_col) = (g.m - 1, g.k.saturating_sub(1));
    // An overflow must be an error, since `tile` reads A and B through raw pointers.
    let reach =
        |steps: usize, stride: usize, more: Option<usize>| steps.checked_mul(stride)?.checked_add(more?);
    let a_reach = reach(last_row, g.a_row, reach(last_col, g.a_col, Some(1)));
    assert!(g.k == 0 || a_reach.is_some_and(|end| a.len() >= end), "gemm: A is too short");
    let b_reach = reach(last_col, g.b_row, Some(g.n));
    assert!(g.k == 0 || b_reach.is_some_and(|end| b.len() >= end), "gemm: B is too short");
    let c_reach = reach(last_row, g.c_row, Some(g.n));
    let rows_apart = g.m == 1 || g.c_row >= g.n;
    assert!(rows_apart && c_reach.is_some_and(|end| c.len() >= end), "gemm: C is too short");
    if let Init::Bias(bias) = init {
        assert!(bias.len() >= g.m, "gemm: bias is too short");
    }
    isa.run_columns(g.n, Product { g, a, b, c, init, relu });
}

/// Arguments of [`gemm`], which has checked that every slice is long enough.
struct Product<'a> {
    g: Gemm,
    a: &'a [f32],
    b: &'a [f32],
    c: &'a mut [f32],
    init: Init<'a>,
    relu: bool,
}

impl Op for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(mut self) {
        const { assert!(1 <= V::TILE_ROWS && V::TILE_ROWS <= 6, "the panels below have 1 to 6 rows") };
        let mut row = 0;
        while row < self.g.m {
            let rows = V::TILE_ROWS.min(self.g.m - row);
            match rows {
                1 => self.panel::<V, 1>(row),
                2 => self.panel::<V, 2>(row),
                3 => self.panel::<V, 3>(row),
                4 => self.panel::<V, 4>(row),
                5 => self.panel::<V, 5>(row),
                _ => self.panel::<V, 6>(row),
            }
            row += rows;
        }
    }
}

impl Product<'_> {
    /// Computes `ROWS` rows of C from `row` on, tile by tile.
    #[inline(always)]
    fn panel<V: Lanes, const ROWS: usize>(&mut self, row: usize) {
        let mut col = 0;
        while col < self.g.n {
            let left = (self.g.n - col) / V::COUNT;
            if V::TILE_COLS >= 4 && left >= 4 {
                self.tile::<V, ROWS, 4>(row, col);
                col += 4 * V::COUNT;
            } else if V::TILE_COLS >= 2 && left >= 2 {
                self.tile::<V, ROWS, 2>(row, col);
                col += 2 * V::COUNT;
            } else {
                self.tile::<V, ROWS, 1>(row, col);
                col += V::COUNT;
            }
        }
    }

    /// Computes one tile: `ROWS` rows × `COLS` vectors of C. The sums stay in registers over all `k` terms.
    #[inline(always)]
    fn tile<V: Lanes, const ROWS: usize, const COLS: usize>(&mut self, row: usize, col: usize) {
        let g = &self.g;
        let mut sums = [[V::splat(0.0); COLS]; ROWS];
        match self.init {
            Init::Zero => {}
            Init::Bias(bias) => {
                for (i, sums) in sums.iter_mut().enumerate() {
                    *sums = [V::splat(bias[row + i]); COLS];
                }
            }
            Init::Accumulate => {
                for (i, sums) in sums.iter_mut().enumerate() {
                    let from = &self.c[(row + i) * g.c_row + col..][..COLS * V::COUNT];
                    for (j, sum) in sums.iter_mut().enumerate() {
                        *sum = V::load(&from[j * V::COUNT..]);
                    }
                }
            }
        }
        let a = self.a.as_ptr().wrapping_add(row * g.a_row);
        let b = self.b.as_ptr().wrapping_add(col);
        for p in 0..g.k {
            let mut x = [V::splat(0.0); COLS];
            for (j, x) in x.iter_mut().enumerate() {
                let from = b.wrapping_add(p * g.b_row + j * V::COUNT);
                // SAFETY: `gemm` checked that row `p` of B holds `n` columns, and this tile's
                // columns end at or before `n`.
                *x = V::load(unsafe { core::slice::from_raw_parts(from, V::COUNT) });
            }
            for (i, sums) in sums.iter_mut().enumerate() {
                // SAFETY: `gemm` checked that A reaches to row `m - 1`, column `k - 1`.
                let weight = V::splat(unsafe { *a.wrapping_add(i * g.a_row + p * g.a_col) });
                for (sum, &x) in sums.iter_mut().zip(&x) {
                    *sum = weight.mul_add(x, *sum);
                }
            }
        }
        for (i, sums) in sums.iter().enumerate() {
            let to = &mut self.c[(row + i) * g.c_row + col..][..COLS * V::COUNT];
            for (j, &sum) in sums.iter().enumerate() {
                let sum = if self.relu { V::splat(0.0).max_of(sum) } else { sum };
                sum.store(&mut to[j * V::COUNT..]);
            }
        }
    }
}
