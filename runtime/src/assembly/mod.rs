//! The loops in assembly, and the data that they read.
//!
//! This module chooses the loops: those for a Cortex-M55 with the feature `cortex-m55`, otherwise those for a Cortex-M4F;
//! other targets and `portable-kernels` have none. [`crate::gp::loops`] assigns a loop to each shape of rows; the portable
//! loops serve the rest. All loops produce the same bits. This module holds the only unsafe code of the crate.

/// One instruction with three operands.
#[cfg(all(
    target_arch = "arm",
    target_abi = "eabihf",
    not(feature = "portable-kernels")
))]
macro_rules! step {
    ($does:literal, $to:literal, $a:literal, $b:literal) => {
        concat!($does, " ", $to, ", ", $a, ", ", $b, "\n")
    };
}

#[cfg(all(
    target_arch = "arm",
    target_abi = "eabihf",
    not(feature = "portable-kernels"),
    not(feature = "cortex-m55")
))]
pub(crate) mod cortex_m4;
#[cfg(all(
    target_arch = "arm",
    target_abi = "eabihf",
    not(feature = "portable-kernels"),
    feature = "cortex-m55"
))]
pub(crate) mod cortex_m55;
#[cfg(all(
    target_arch = "arm",
    target_abi = "eabihf",
    not(feature = "portable-kernels")
))]
pub(crate) mod fourier;
#[cfg(all(
    target_arch = "arm",
    target_abi = "eabihf",
    not(feature = "portable-kernels")
))]
pub(crate) mod square_root;

use heapless::Vec;
use poegp_protocol::limits::MAX_GROUPS;

/// 1.5·2²³: adding it to an `f32` of magnitude below 2²² leaves the nearest integer in the low mantissa bits.
pub(crate) const EXP2_ROUND: f32 = 12_582_912.0;

/// Coefficients of the polynomial of [`Scalar::exp2`](crate::math::scalar::Scalar::exp2) for `f32` after the constant 1,
/// lowest power first.
pub(crate) const EXP2: [f32; 5] = [
    f32::from_bits(0x3f31_7215),
    f32::from_bits(0x3e75_fce1),
    f32::from_bits(0x3d63_5b6c),
    f32::from_bits(0x3c1e_7457),
    f32::from_bits(0x3aad_ed2c),
];

/// Constants of [`Scalar::exp2_scaled`](crate::math::scalar::Scalar::exp2_scaled) for `f32`: 1.5·2²³ minus 10, which takes
/// 2¹⁰ out of the result, then the polynomial of `exp2` divided by its leading coefficient, highest power first.
pub(crate) const EXP2_SCALED: [f32; 6] = [
    12_582_902.0,
    f32::from_bits(0x40e9_3a1b),
    f32::from_bits(0x4227_526a),
    f32::from_bits(0x4335_0877),
    f32::from_bits(0x4402_9705),
    f32::from_bits(0x443c_66c7),
];

/// Constants of [`Scalar::sin_cos`](crate::math::scalar::Scalar::sin_cos) for `f32`: 2/π, the three parts of π/2, then the
/// coefficients of the sine and those of the cosine, highest power first.
pub(crate) const SINES: [f32; 10] = [
    core::f32::consts::FRAC_2_PI,
    1.570_312_5,
    4.837_513e-4,
    7.549_79e-8,
    -1.951_529_6e-4,
    8.332_161e-3,
    -1.666_665_5e-1,
    2.443_315_7e-5,
    -1.388_731_6e-3,
    4.166_664_6e-2,
];

/// Number of landmarks whose coefficients are stored together.
pub(crate) const BLOCK: usize = 4;

/// Returns the number of coefficients of block `index`: its linear ones, and those with itself and all blocks before it.
pub(crate) const fn block_words(index: usize) -> usize {
    BLOCK + BLOCK * BLOCK * (index + 1)
}

/// The first rows of an inducing set, divided into blocks. No block is empty, and [`Blocks::rows`] is the sum of their rows:
/// assembly relies on both.
#[derive(Debug)]
pub struct Blocks<T> {
    list: Vec<Block<T>, MAX_GROUPS>,
    rows: usize,
}

/// The number of rows of one payload group and the factor of their sum. Assembly reads its layout as two words.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Block<T> {
    pub(crate) rows: u32,
    pub(crate) factor: T,
}

impl<T: Copy> Blocks<T> {
    /// Returns no blocks.
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Self {
            list: Vec::new(),
            rows: 0,
        }
    }

    /// Replaces the blocks with these numbers of rows, each with the factor of its sum; leaves out those of 0 rows and any
    /// beyond [`MAX_GROUPS`]. In place, because creating and moving a list costs more than filling it.
    #[inline(always)]
    pub(crate) fn refill(&mut self, blocks: impl Iterator<Item = (u16, T)>) {
        self.list.clear();
        let mut sum = 0;
        for (rows, factor) in blocks {
            let block = Block {
                rows: u32::from(rows),
                factor,
            };
            if rows > 0 && self.list.push(block).is_ok() {
                sum += usize::from(rows);
            }
        }
        self.rows = sum;
    }

    /// Returns the blocks in the order of the rows.
    #[inline(always)]
    pub(crate) fn list(&self) -> &[Block<T>] {
        &self.list
    }

    /// Returns the number of rows of all blocks.
    #[inline(always)]
    pub(crate) fn rows(&self) -> usize {
        self.rows
    }
}
