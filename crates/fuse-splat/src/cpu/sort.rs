//! One depth sort for the whole image: visible Gaussians, nearest first, ties by index.

use crate::stages::Splat;

/// Bits that one pass sorts by; three passes cover the 32 bits of a depth.
const BITS: u32 = 11;
const BUCKETS: usize = 1 << BITS;

/// Buffers that are kept between calls.
#[derive(Debug, Default)]
pub(crate) struct DepthSort {
    from: Vec<(u32, u32)>,
    to: Vec<(u32, u32)>,
}

impl DepthSort {
    /// Fills `order` with the indices of the visible splats.
    ///
    /// Bits of positive floats are ordered as the floats are; a stable radix sort keeps ties in
    /// order of index.
    pub fn sort(&mut self, splats: &[Splat], order: &mut Vec<u32>) {
        self.from.clear();
        let visible = splats.iter().enumerate().filter(|(_, s)| s.depth > 0.0);
        self.from.extend(visible.map(|(i, s)| (s.depth.to_bits(), i as u32)));
        self.to.resize(self.from.len(), (0, 0));
        for pass in 0..3 {
            let digit = |key: u32| (key >> (pass * BITS)) as usize % BUCKETS;
            let mut starts = [0u32; BUCKETS];
            for &(key, _) in &self.from {
                starts[digit(key)] += 1;
            }
            let mut sum = 0;
            for s in &mut starts {
                sum += std::mem::replace(s, sum);
            }
            for &pair in &self.from {
                let at = &mut starts[digit(pair.0)];
                self.to[*at as usize] = pair;
                *at += 1;
            }
            std::mem::swap(&mut self.from, &mut self.to);
        }
        order.clear();
        order.extend(self.from.iter().map(|&(_, i)| i));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_first_and_ties_by_index() {
        let depths = [3.5, 0.0, 0.25, 1e6, 3.5, 0.200_000_02, 0.0, 77.0, 0.25];
        let splats: Vec<Splat> = depths.iter().map(|&depth| Splat { depth, ..Splat::default() }).collect();
        let mut order = vec![9; 3];
        DepthSort::default().sort(&splats, &mut order);
        assert_eq!(order, [5, 2, 8, 0, 4, 7, 3]);
    }
}
