//! Seeded choices that keep the splits apart.

use glam::Vec3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::catalogue::{Category, Split};

/// Names that one split may draw from.
#[derive(Clone, Copy, Debug)]
pub struct Families {
    /// For training instances.
    pub train: &'static [&'static str],
    /// For development instances.
    pub dev: &'static [&'static str],
    /// For evaluation instances.
    pub eval: &'static [&'static str],
}

impl Families {
    /// The names of a split.
    pub fn of(&self, split: Split) -> &'static [&'static str] {
        match split {
            Split::Train => self.train,
            Split::Dev => self.dev,
            Split::Eval => self.eval,
        }
    }
}

/// The parts of a parameter's whole range, as fractions, that a split draws from. Development
/// and evaluation lie outside of training on both sides.
pub fn bands(split: Split) -> &'static [(f32, f32)] {
    match split {
        Split::Train => &[(0.15, 0.85)],
        Split::Dev => &[(0.07, 0.15), (0.85, 0.93)],
        Split::Eval => &[(0.0, 0.07), (0.93, 1.0)],
    }
}

/// The parts of the hue circle (0 to 1) that a split draws from.
pub fn hues(split: Split) -> &'static [(f32, f32)] {
    match split {
        Split::Train => &[(0.97, 1.06), (0.11, 0.22), (0.27, 0.40), (0.54, 0.66), (0.76, 0.90)],
        Split::Dev => &[(0.06, 0.085), (0.40, 0.44), (0.66, 0.70), (0.90, 0.93)],
        Split::Eval => &[(0.085, 0.11), (0.22, 0.27), (0.44, 0.54), (0.70, 0.76), (0.93, 0.97)],
    }
}

/// Random choices of one object.
pub struct Dice {
    rng: ChaCha8Rng,
    split: Split,
}

impl Dice {
    /// Dice that depend on category, split and seed alone.
    pub fn new(category: Category, split: Split, seed: u64) -> Self {
        let mut key = [0u8; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8] = Category::ALL.iter().position(|c| *c == category).unwrap_or(Category::ALL.len()) as u8;
        key[9] = split as u8;
        key[10..14].copy_from_slice(b"fuse");
        Self { rng: ChaCha8Rng::from_seed(key), split }
    }

    /// The split whose ranges are drawn from.
    pub fn split(&self) -> Split {
        self.split
    }

    /// A seed for noise.
    pub fn seed(&mut self) -> u32 {
        self.rng.next_u32()
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f32 {
        (self.rng.next_u32() >> 8) as f32 / (1 << 24) as f32
    }

    /// Uniform in [low, high), the same for every split: for what makes no instance different
    /// in kind.
    pub fn any(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// True with probability `p`.
    pub fn chance(&mut self, p: f32) -> bool {
        self.unit() < p
    }

    /// A shape parameter whose whole range is [low, high]; the split draws from its bands.
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.banded(bands(self.split))
    }

    fn banded(&mut self, bands: &[(f32, f32)]) -> f32 {
        let whole: f32 = bands.iter().map(|b| b.1 - b.0).sum();
        let mut at = self.unit() * whole;
        for &(low, high) in bands {
            if at < high - low {
                return low + at;
            }
            at -= high - low;
        }
        bands[bands.len() - 1].1
    }

    /// One of several.
    pub fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[(self.unit() * of.len() as f32) as usize % of.len()]
    }

    /// One of the split's names.
    pub fn family(&mut self, of: &Families) -> &'static str {
        self.pick(of.of(self.split))
    }

    /// A colour with one of the split's hues, sRGB in [0, 1].
    pub fn color(&mut self, saturation: (f32, f32), value: (f32, f32)) -> Vec3 {
        let hue = self.banded(hues(self.split));
        let (s, v) = (self.any(saturation.0, saturation.1), self.any(value.0, value.1));
        hsv(hue, s, v)
    }

    /// A lively colour.
    pub fn vivid(&mut self) -> Vec3 {
        self.color((0.5, 0.93), (0.32, 0.9))
    }

    /// A tint of a tone, each channel multiplied by up to `by` either way.
    pub fn tint(&mut self, tone: Vec3, by: f32) -> Vec3 {
        let all = self.any(1.0 - by, 1.0 + by);
        let each = Vec3::new(self.any(-0.3, 0.3), self.any(-0.3, 0.3), self.any(-0.3, 0.3)) * by;
        (tone * (all + each)).clamp(Vec3::ZERO, Vec3::ONE)
    }
}

/// sRGB of hue (turns), saturation, value.
pub fn hsv(h: f32, s: f32, v: f32) -> Vec3 {
    let channel = |n: f32| {
        let k = (n + h * 6.0).rem_euclid(6.0);
        v - v * s * k.min(4.0 - k).clamp(0.0, 1.0)
    };
    Vec3::new(channel(5.0), channel(3.0), channel(1.0))
}
