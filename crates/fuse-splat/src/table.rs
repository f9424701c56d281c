//! 59 floats for each Gaussian, in blocks of eight: parameters, moments and gradients alike.

use crate::constants::PARAMETERS;

/// Gaussians in a block, one a SIMD lane.
pub const LANES: usize = 8;

/// Eight Gaussians: row `r`, lane `l` is parameter `r` of the block's Gaussian `l`.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(32))]
pub struct Block(pub [[f32; LANES]; PARAMETERS]);

impl Block {
    /// All zeros.
    pub const ZERO: Self = Self([[0.0; LANES]; PARAMETERS]);
}

/// A list of 59-vectors, in blocks of eight. Lanes past the end of the last block mean nothing.
#[derive(Clone, Debug, Default)]
pub struct Table {
    blocks: Vec<Block>,
    len: usize,
}

impl Table {
    /// `len` zero vectors.
    pub fn zeros(len: usize) -> Self {
        Self { blocks: vec![Block::ZERO; len.div_ceil(LANES)], len }
    }

    /// Number of vectors.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The blocks.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// The blocks.
    pub fn blocks_mut(&mut self) -> &mut [Block] {
        &mut self.blocks
    }

    /// The blocks' numbers as they lie in memory: (blocks, 59, 8).
    pub fn numbers(&self) -> &[f32] {
        bytemuck::cast_slice(&self.blocks)
    }

    /// Element `row` of vector `i`.
    pub fn get(&self, i: usize, row: usize) -> f32 {
        self.blocks[i / LANES].0[row][i % LANES]
    }

    /// Sets element `row` of vector `i`.
    pub fn set(&mut self, i: usize, row: usize, value: f32) {
        self.blocks[i / LANES].0[row][i % LANES] = value;
    }

    /// `N` elements of vector `i` from `row` on.
    pub fn rows<const N: usize>(&self, i: usize, row: usize) -> [f32; N] {
        std::array::from_fn(|k| self.get(i, row + k))
    }

    /// Vector `i`.
    pub fn vector(&self, i: usize) -> [f32; PARAMETERS] {
        self.rows(i, 0)
    }

    /// Appends a vector.
    pub fn push(&mut self, vector: &[f32; PARAMETERS]) {
        if self.len.is_multiple_of(LANES) {
            self.blocks.push(Block::ZERO);
        }
        self.len += 1;
        for (row, &v) in vector.iter().enumerate() {
            self.set(self.len - 1, row, v);
        }
    }

    /// Keeps the vectors `i` with `keep[i]`, in order.
    pub fn retain(&mut self, keep: &[bool]) {
        let mut kept = 0;
        for (i, _) in keep.iter().enumerate().filter(|&(_, &k)| k) {
            if i != kept {
                for row in 0..PARAMETERS {
                    self.set(kept, row, self.get(i, row));
                }
            }
            kept += 1;
        }
        self.len = kept;
        self.blocks.truncate(kept.div_ceil(LANES));
    }
}

impl PartialEq for Table {
    fn eq(&self, other: &Self) -> bool {
        self.len == other.len && (0..self.len).all(|i| self.vector(i) == other.vector(i))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn retained_vectors_keep_their_order_and_values() {
        let mut t = Table::default();
        for i in 0..21 {
            t.push(&std::array::from_fn(|r| (i * 100 + r) as f32));
        }
        let keep: Vec<bool> = (0..21).map(|i| i % 3 != 1).collect();
        t.retain(&keep);
        assert_eq!(t.len(), 14);
        assert_eq!(t.blocks().len(), 2);
        let firsts: Vec<f32> = (0..14).map(|i| t.get(i, 58)).collect();
        let expected: Vec<f32> = (0..21).filter(|i| i % 3 != 1).map(|i| (i * 100 + 58) as f32).collect();
        assert_eq!(firsts, expected);
    }
}
