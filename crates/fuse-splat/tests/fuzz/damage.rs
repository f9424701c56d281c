//! Random damage, the same for the same seed.

/// Numbers that readers trip over: counts, lengths, exponents of floats that are not finite.
const NASTY: [u64; 10] =
    [0, 1, 0x7f, 0xff, 0x7fff_ffff, 0xffff_ffff, 1_000_000_000, 0x7fff_ffff_ffff_ffff, u64::MAX, 0x7ff8_0000_0000_0000];
const WORDS: [&str; 12] =
    ["0", "-1", "NaN", "inf", "1e999", "999999999999999999999", "\n", " ", "../x", "null", "\"", "4294967296"];

pub struct Damage(u64);

impl Damage {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % n.max(1)
    }

    /// A copy with one to three faults.
    pub fn apply(&mut self, original: &[u8]) -> Vec<u8> {
        let mut bytes = original.to_vec();
        for _ in 0..=self.below(3) {
            self.fault(&mut bytes);
        }
        bytes
    }

    fn fault(&mut self, bytes: &mut Vec<u8>) {
        let at = self.below(bytes.len());
        let length = self.below(24).min(bytes.len() - at);
        match self.below(8) {
            0 if !bytes.is_empty() => bytes[at] ^= 1 << self.below(8),
            1 if !bytes.is_empty() => bytes[at] = self.below(256) as u8,
            2 => {
                let number = NASTY[self.below(NASTY.len())].to_le_bytes();
                let size = [1, 2, 4, 8][self.below(4)].min(bytes.len() - at);
                bytes[at..at + size].copy_from_slice(&number[..size]);
            }
            3 => bytes.truncate(at),
            4 => drop(bytes.drain(at..at + length)),
            5 => {
                let piece = bytes[at..at + length].to_vec();
                let to = self.below(bytes.len());
                bytes.splice(to..to, piece);
            }
            6 => {
                let word = WORDS[self.below(WORDS.len())].bytes();
                bytes.splice(at..at, word);
            }
            _ => {
                // A word of text, if it is one, for another.
                let end = bytes[at..].iter().position(u8::is_ascii_whitespace).map_or(bytes.len(), |n| at + n);
                let word = WORDS[self.below(WORDS.len())].bytes();
                bytes.splice(at..end.min(at + 30), word);
            }
        }
    }
}
