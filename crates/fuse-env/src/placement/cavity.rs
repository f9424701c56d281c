//! Where an open vessel is hollow, found by looking down into it and asking how high it would hold water.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use rapier3d::geometry::{Ray, RayCast, TriMesh};
use rapier3d::glamx::{Vec2, Vec3};

/// Distance of the rays, metres.
const STEP: f32 = 0.003;
/// Depth of water from which a place belongs to a cavity, metres.
const DEEP: f32 = 0.005;
/// Least clear radius of a cavity, metres.
const WIDE: f32 = 0.012;

/// The inside of an open vessel in its natural pose, model axes, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cavity {
    /// Axis of the widest upright cylinder that is empty, x and y.
    pub axis: Vec2,
    /// Radius of that cylinder.
    pub radius: f32,
    /// Half-sizes of the empty cross about the axis along x and y.
    pub half: Vec2,
    /// Height of the floor on the axis.
    pub floor: f32,
    /// Height at which water would run over.
    pub rim: f32,
}

/// Heights of what is seen from above on a grid of rays; `None` beside the model.
struct Grid {
    low: Vec2,
    nx: usize,
    ny: usize,
    heights: Vec<Option<f32>>,
}

impl Grid {
    fn new(parts: &[TriMesh], samples: &[Vec3], low: Vec3, high: Vec3) -> Self {
        let n = |size: f32| (size / STEP).ceil() as usize + 2;
        let (nx, ny) = (n(high.x - low.x), n(high.y - low.y));
        let mut grid = Self { low: Vec2::new(low.x, low.y), nx, ny, heights: vec![] };
        let seen = |p: Vec2| {
            let ray = Ray::new(Vec3::new(p.x, p.y, high.z + 0.01), -Vec3::Z);
            parts.iter().filter_map(|m| m.cast_local_ray(&ray, 2.0, true)).map(|t| high.z + 0.01 - t).reduce(f32::max)
        };
        let mut heights: Vec<Option<f32>> = (0..nx * ny).map(|k| seen(grid.at(k))).collect();
        // What a ray misses inside the outline is a hole in the floor: water would not get far there.
        let empty: Vec<bool> = heights.iter().map(Option::is_none).collect();
        let border = |k: usize| k.is_multiple_of(nx) || k % nx == nx - 1 || k < nx || k >= nx * (ny - 1);
        let mut outside: Vec<bool> = (0..nx * ny).map(border).collect();
        let mut queue: Vec<usize> = (0..nx * ny).filter(|&k| outside[k]).collect();
        while let Some(k) = queue.pop() {
            for m in grid.beside(k) {
                if empty[m] && !outside[m] {
                    outside[m] = true;
                    queue.push(m);
                }
            }
        }
        for k in 0..nx * ny {
            if empty[k] && !outside[k] {
                heights[k] = Some(low.z);
            }
        }
        // Rays miss a thin rim; points on the surface do not.
        for p in samples {
            let cell = ((Vec2::new(p.x, p.y) - grid.low) / STEP + Vec2::ONE).floor();
            if let Some(Some(h)) = heights.get_mut(cell.y as usize * nx + cell.x as usize) {
                *h = h.max(p.z);
            }
        }
        grid.heights = heights;
        grid
    }

    fn at(&self, k: usize) -> Vec2 {
        self.low + Vec2::new((k % self.nx) as f32 - 0.5, (k / self.nx) as f32 - 0.5) * STEP
    }

    fn beside(&self, k: usize) -> impl Iterator<Item = usize> {
        let (i, j, nx, ny) = (k % self.nx, k / self.nx, self.nx, self.ny);
        let next = [
            (i > 0).then(|| k - 1),
            (i + 1 < nx).then_some(k + 1),
            (j > 0).then(|| k - nx),
            (j + 1 < ny).then_some(k + nx),
        ];
        next.into_iter().flatten()
    }

    /// Level of the water at every cell after endless rain: the lowest highest point on a way out.
    fn levels(&self) -> Vec<f32> {
        let mut level = vec![f32::INFINITY; self.heights.len()];
        // Heights in whole micrometres, so that the heap has an order.
        let key = |h: f32| (f64::from(h) * 1e6) as i64;
        let mut heap = BinaryHeap::new();
        for (k, h) in self.heights.iter().enumerate() {
            if h.is_none() {
                level[k] = f32::NEG_INFINITY;
                heap.push((Reverse(i64::MIN), k));
            }
        }
        while let Some((_, k)) = heap.pop() {
            for m in self.beside(k) {
                if level[m] == f32::INFINITY {
                    level[m] = self.heights[m].unwrap_or(f32::NEG_INFINITY).max(level[k]);
                    heap.push((Reverse(key(level[m])), m));
                }
            }
        }
        level
    }
}

/// The cavity of a model given as its closed parts and points on their surface; `None` when it is not
/// an open vessel.
pub fn find(parts: &[TriMesh], samples: &[Vec3], low: Vec3, high: Vec3) -> Option<Cavity> {
    let grid = Grid::new(parts, samples, low, high);
    let level = grid.levels();
    let depth = |k: usize| grid.heights[k].map_or(0.0, |h| level[k] - h);
    let deepest = (0..level.len()).map(depth).fold(0.0, f32::max);
    if deepest < DEEP {
        return None;
    }
    // Half as deep as the deepest: the slope of a bowl's wall is no floor.
    let inside: Vec<bool> = (0..level.len()).map(|k| depth(k) > 0.5 * deepest).collect();
    let walls: Vec<Vec2> =
        (0..level.len()).filter(|&k| !inside[k] && grid.beside(k).any(|m| inside[m])).map(|k| grid.at(k)).collect();
    let clear = |k: usize| walls.iter().map(|w| w.distance_squared(grid.at(k))).fold(f32::MAX, f32::min).sqrt();
    let clearances: Vec<f32> = (0..level.len()).map(|k| if inside[k] { clear(k) } else { 0.0 }).collect();
    let widest = clearances.iter().copied().fold(0.0, f32::max);
    // A long tray is equally wide along its length: the middle of that is the axis.
    let wide: Vec<usize> = (0..level.len()).filter(|&k| clearances[k] > 0.97 * widest).collect();
    let middle = wide.iter().map(|&k| grid.at(k)).sum::<Vec2>() / wide.len().max(1) as f32;
    let from_middle = |k: &usize| grid.at(*k).distance_squared(middle);
    let best = wide.into_iter().min_by(|a, b| from_middle(a).total_cmp(&from_middle(b)))?;
    let radius = clearances[best] - STEP;
    if radius < WIDE {
        return None;
    }
    let run = |step: isize| {
        let steps = (1..).take_while(|n| inside.get((best as isize + n * step) as usize).copied().unwrap_or(false));
        steps.count() as f32 * STEP
    };
    let row = grid.nx as isize;
    let half = Vec2::new(run(1).min(run(-1)), run(row).min(run(-row)));
    Some(Cavity { axis: grid.at(best), radius, half, floor: grid.heights[best]?, rim: level[best] })
}
