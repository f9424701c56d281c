//! Weighted sums over a disc of the shadow map.

use fuse_camera::simd::{F32x8, Kernel};
use glam::Vec2;

use super::super::lanes::clamp;
use super::{Level, floor};

/// Sums over a disc of the map.
#[derive(Default)]
pub(super) struct Disc {
    pub weight: f32,
    /// Weight of blockers.
    pub blocked: f32,
    /// Their inverse depth times weight.
    pub depth: f32,
}

/// What [`Disc`] is summed from, in texels of the level.
pub(super) struct DiscSum<'a> {
    pub level: &'a Level,
    pub radius: f32,
    pub at: Vec2,
    pub slope: Vec2,
    /// Inverse depth of the receiver at `at`.
    pub w: f32,
}

impl Kernel for DiscSum<'_> {
    type Output = Disc;

    #[inline(always)]
    fn run<V: F32x8>(self) -> Disc {
        let Self { level, radius, at, slope, w } = self;
        let (x0, x1) = (floor(at.x - radius) + 1, floor(at.x + radius));
        let (y0, y1) = (floor(at.y - radius) + 1, floor(at.y + radius));
        let (zero, one, half) = (V::zero(), V::splat(1.0), V::splat(0.5));
        let lanes = V::load(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        let (mut weights, mut blocked, mut depth) = (zero, zero, zero);
        for y in y0..=y1 {
            let dy = y as f32 - at.y;
            let mut x = x0;
            while x <= x1 {
                let dx = lanes + V::splat(x as f32 - at.x);
                let weight = clamp(V::splat(radius) - (dx * dx + V::splat(dy * dy)).sqrt(), 0.0, 1.0);
                let (near, far) = eight::<V>(level, x, y);
                let plane = V::splat(w + slope.y * dy) + V::splat(slope.x) * dx;
                // A block of texels that is blocked in part counts half.
                let counts = one.and(near.gt(plane)) + one.and(far.gt(plane));
                let hidden = weight * half * counts;
                weights = weights + weight;
                blocked = blocked + hidden;
                depth = depth + hidden * near;
                x += 8;
            }
        }
        let sums = V::sums([weights, blocked, depth, zero, zero, zero, zero, zero]);
        Disc { weight: sums[0], blocked: sums[1], depth: sums[2] }
    }
}

/// Eight texels of a row, those beyond the border as on it.
#[inline(always)]
fn eight<V: F32x8>(level: &Level, x: i32, y: i32) -> (V, V) {
    if x >= 0 && x as usize + 8 <= level.side {
        let at = level.place(x, y);
        return (V::load_slice(&level.near[at..]), V::load_slice(&level.far[at..]));
    }
    let (mut near, mut far) = ([0.0; 8], [0.0; 8]);
    for i in 0..8 {
        let at = level.place(x + i as i32, y);
        (near[i], far[i]) = (level.near[at], level.far[at]);
    }
    (V::load(&near), V::load(&far))
}
