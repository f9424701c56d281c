//! Laying objects out on a table so that they rest on it, do not touch and hide one another.
//!
//! Two objects are kept apart by their footprints: the convex hulls of their vertical projections,
//! at least `gap` apart. That is conservative: it also forbids what would fit under something.

pub mod cavity;
pub mod check;
pub mod compound;
pub mod layout;
mod piece;
pub mod settle;
pub mod solid;
pub mod units;

use std::f32::consts::TAU;

use fuse_render::Model;
use glam::{Affine3A, Mat3, Quat, Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::configuration::SceneConfiguration;
use crate::room;

/// Distance of every footprint from the table's edge, metres.
const EDGE_MARGIN: f32 = 0.015;
/// Positions that are tried for one object before the layout is given up.
const TRIES: usize = 600;
/// Sound positions among which the best is taken.
const CHOICES: usize = 8;

/// A way in which a model comes to rest on a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rest {
    /// Rotation model → world, before the random turn about z.
    pub rotation: Quat,
    /// Relative frequency.
    pub probability: f32,
}

/// An object to be placed.
#[derive(Clone, Copy, Debug)]
pub struct Item<'a> {
    /// Its model.
    pub model: &'a Model,
    /// How it may rest; not empty.
    pub rests: &'a [Rest],
}

/// Where an object came to lie.
#[derive(Clone, Debug, PartialEq)]
pub struct Placed {
    /// Rotation model → world.
    pub rotation: Quat,
    /// Position of the model's origin, metres.
    pub translation: Vec3,
    /// Convex footprint in world x and y, counter-clockwise.
    pub footprint: Vec<Vec2>,
    /// Height above the table, metres.
    pub height: f32,
}

impl Placed {
    /// World from model.
    pub fn transform(&self) -> Affine3A {
        Affine3A::from_rotation_translation(self.rotation, self.translation)
    }
}

/// The place that objects are laid out on, and the style.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    /// Convex outline of the table top, counter-clockwise, world metres.
    pub outline: Vec<Vec2>,
    /// Height of the table top, metres.
    pub height: f32,
    /// Middle of the ellipse that holds the objects' centres.
    pub center: Vec2,
    /// Semi-axes of that ellipse.
    pub extent: Vec2,
    /// 0 spreads evenly, 1 heaps around the first object.
    pub tightness: f32,
    /// Smallest gap between footprints, metres.
    pub gap: f32,
}

impl Surface {
    /// The table of a scene.
    pub fn of(scene: &SceneConfiguration) -> Self {
        Self {
            outline: room::table_outline(&scene.table),
            height: scene.table.height_m,
            center: Vec2::from_array(scene.table.center_m),
            extent: Vec2::from_array(scene.clutter.extent_m),
            tightness: scene.clutter.tightness,
            gap: scene.clutter.gap_m,
        }
    }
}

/// Why no layout was found.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlacementError {
    /// No room was left.
    #[error("no room on the table for object {index} of {count}")]
    Full {
        /// Position in the list of items.
        index: usize,
        /// Number of items.
        count: usize,
    },
    /// An item has no vertices or no way to rest.
    #[error("object {0} has no vertices or no resting pose")]
    Empty(usize),
}

/// Convex hull by Andrew's monotone chain, counter-clockwise, without collinear points.
pub fn convex_hull(points: impl IntoIterator<Item = Vec2>) -> Vec<Vec2> {
    let mut points: Vec<Vec2> = points.into_iter().collect();
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let mut hull: Vec<Vec2> = Vec::new();
    for pass in 0..2 {
        let start = hull.len();
        let mut add = |p: Vec2| {
            while hull.len() >= start + 2
                && (hull[hull.len() - 1] - hull[hull.len() - 2]).perp_dot(p - hull[hull.len() - 1]) <= 0.0
            {
                hull.pop();
            }
            hull.push(p);
        };
        if pass == 0 {
            points.iter().copied().for_each(&mut add);
        } else {
            points.iter().rev().copied().for_each(&mut add);
        }
        hull.pop();
    }
    hull
}

/// Largest separation of two convex polygons over the edge normals of both: a lower bound of their
/// distance, negative when they overlap.
pub fn separation(a: &[Vec2], b: &[Vec2]) -> f32 {
    let one_way = |p: &[Vec2], q: &[Vec2]| {
        (0..p.len())
            .map(|i| {
                let (s, e) = (p[i], p[(i + 1) % p.len()]);
                let outward = (e - s).perp().normalize_or_zero() * -1.0;
                q.iter().map(|v| (*v - s).dot(outward)).fold(f32::MAX, f32::min)
            })
            .fold(f32::MIN, f32::max)
    };
    one_way(a, b).max(one_way(b, a))
}

/// Whether every point of `inner` is at least `margin` inside the convex counter-clockwise `outer`.
fn contains(outer: &[Vec2], inner: &[Vec2], margin: f32) -> bool {
    (0..outer.len()).all(|i| {
        let (s, e) = (outer[i], outer[(i + 1) % outer.len()]);
        let inward = (e - s).perp().normalize_or_zero();
        inner.iter().all(|p| (*p - s).dot(inward) >= margin)
    })
}

/// An item turned into one of its resting poses, not yet moved.
struct Turned {
    rotation: Quat,
    /// Footprint about its own centroid.
    hull: Vec<Vec2>,
    /// From the footprint's centroid to the model's origin, and up so that the lowest point is at 0.
    origin: Vec3,
    height: f32,
    radius: f32,
}

/// A unit vector at a random angle. Sine and cosine are the physics engine's, which are the same on
/// every machine; the system's are not.
pub(crate) fn direction(rng: &mut ChaCha8Rng) -> Vec2 {
    let v = rapier3d::glamx::Vec2::from_angle(rng.random::<f32>() * TAU);
    Vec2::new(v.x, v.y)
}

fn turn(item: &Item<'_>, rest: Quat, half_yaw: Vec2) -> Option<Turned> {
    let rotation = (Quat::from_xyzw(0.0, 0.0, half_yaw.y, half_yaw.x) * rest).normalize();
    let matrix = Mat3::from_quat(rotation);
    let points: Vec<Vec3> = item.model.meshes.iter().flat_map(|m| m.positions.iter().map(|p| matrix * *p)).collect();
    let low = points.iter().map(|p| p.z).reduce(f32::min)?;
    let high = points.iter().map(|p| p.z).reduce(f32::max)?;
    let hull = convex_hull(points.iter().map(|p| p.truncate()));
    let center = hull.iter().sum::<Vec2>() / hull.len() as f32;
    let hull: Vec<Vec2> = hull.iter().map(|p| *p - center).collect();
    let radius = hull.iter().map(|p| p.length()).fold(0.0, f32::max);
    Some(Turned { rotation, hull, origin: (-center).extend(-low), height: high - low, radius })
}

fn pick_rest(rests: &[Rest], rng: &mut ChaCha8Rng) -> Quat {
    let total: f32 = rests.iter().map(|r| r.probability).sum();
    let mut left = rng.random::<f32>() * total;
    for rest in rests {
        left -= rest.probability;
        if left <= 0.0 {
            return rest.rotation;
        }
    }
    rests[rests.len() - 1].rotation
}

/// A point of the ellipse, uniformly over its area.
fn anywhere(surface: &Surface, rng: &mut ChaCha8Rng) -> Vec2 {
    let radius = rng.random::<f32>().sqrt();
    surface.center + direction(rng) * radius * surface.extent
}

/// A point beside an object that is already there: about as far as both radii allow.
fn beside(other: &Placed, own: f32, surface: &Surface, rng: &mut ChaCha8Rng) -> Vec2 {
    let center = other.footprint.iter().sum::<Vec2>() / other.footprint.len() as f32;
    let radius = other.footprint.iter().map(|p| p.distance(center)).fold(0.0, f32::max);
    let reach = rng.random_range(0.25..1.0) * (own + radius) + surface.gap + 0.03 * rng.random::<f32>();
    center + direction(rng) * reach
}

/// Lower is better: near the heap where the style is tight; tall things near the first object.
fn cost(at: Vec2, height: f32, placed: &[Placed], surface: &Surface, rng: &mut ChaCha8Rng) -> f32 {
    let jitter = rng.random::<f32>() * 0.15;
    let Some(first) = placed.first() else { return at.distance(surface.center) * 0.5 + jitter };
    let anchor = first.footprint.iter().sum::<Vec2>() / first.footprint.len() as f32;
    let tall = (height / 0.15).min(1.2);
    surface.tightness * (0.4 + tall) * at.distance(anchor) + jitter
}

/// Lays `items` out, in their order; the first one is what the others gather around.
///
/// Deterministic in the state of `rng`. Fails when an item finds no room, so callers try again
/// with another seed or fewer items.
pub fn place(items: &[Item<'_>], surface: &Surface, rng: &mut ChaCha8Rng) -> Result<Vec<Placed>, PlacementError> {
    let mut placed: Vec<Placed> = Vec::with_capacity(items.len());
    for (index, item) in items.iter().enumerate() {
        let next = place_one(index, item, &placed, surface, rng)?;
        placed.push(next.ok_or(PlacementError::Full { index, count: items.len() })?);
    }
    Ok(placed)
}

fn place_one(
    index: usize,
    item: &Item<'_>,
    placed: &[Placed],
    surface: &Surface,
    rng: &mut ChaCha8Rng,
) -> Result<Option<Placed>, PlacementError> {
    if item.rests.is_empty() {
        return Err(PlacementError::Empty(index));
    }
    let rest = pick_rest(item.rests, rng);
    // Turning all vertices is the expensive part: a few yaws, many positions each.
    let yaws: Vec<Turned> = (0..6)
        .map(|_| turn(item, rest, direction(rng)).ok_or(PlacementError::Empty(index)))
        .collect::<Result<_, _>>()?;
    let mut best: Option<(f32, Placed)> = None;
    let mut found = 0;
    for _ in 0..TRIES {
        let turned = &yaws[rng.random_range(0..yaws.len())];
        let near = !placed.is_empty() && rng.random::<f32>() < surface.tightness;
        let at = if near {
            beside(&placed[rng.random_range(0..placed.len())], turned.radius, surface, rng)
        } else {
            anywhere(surface, rng)
        };
        if ((at - surface.center) / surface.extent).length_squared() > 1.0 {
            continue;
        }
        let footprint: Vec<Vec2> = turned.hull.iter().map(|p| *p + at).collect();
        if !contains(&surface.outline, &footprint, EDGE_MARGIN)
            || placed.iter().any(|p| separation(&p.footprint, &footprint) < surface.gap)
        {
            continue;
        }
        let cost = cost(at, turned.height, placed, surface, rng);
        if best.as_ref().is_none_or(|b| cost < b.0) {
            let translation = turned.origin + at.extend(surface.height);
            best = Some((cost, Placed { rotation: turned.rotation, translation, footprint, height: turned.height }));
        }
        found += 1;
        if found == CHOICES {
            break;
        }
    }
    Ok(best.map(|b| b.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use fuse_render::Mesh;
    use rand::SeedableRng;

    /// An L of two boxes, so that the hull is not the shape.
    fn angle_piece(size: Vec3) -> Model {
        let mut mesh = Mesh::default();
        for (low, high) in
            [(Vec3::ZERO, size * Vec3::new(1.0, 0.25, 1.0)), (Vec3::ZERO, size * Vec3::new(0.25, 1.0, 0.6))]
        {
            let first = mesh.positions.len() as u32;
            for i in 0..8u32 {
                let t = Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32);
                mesh.positions.push(low + (high - low) * t);
            }
            for [a, b, c, d] in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
                mesh.triangles.push([first + a, first + b, first + c]);
                mesh.triangles.push([first + a, first + c, first + d]);
            }
        }
        Model { meshes: vec![mesh], materials: vec![] }
    }

    fn surface() -> Surface {
        Surface {
            outline: convex_hull((0..40).map(|i| Vec2::from_angle(TAU * i as f32 / 40.0) * Vec2::new(0.7, 0.6))),
            height: 0.75,
            center: Vec2::ZERO,
            extent: Vec2::new(0.4, 0.35),
            tightness: 0.8,
            gap: 0.004,
        }
    }

    #[test]
    fn things_stand_apart_on_the_table() {
        let models: Vec<Model> = (0..13)
            .map(|i| {
                angle_piece(Vec3::new(0.05 + 0.015 * i as f32, 0.06 + 0.02 * (i % 4) as f32, 0.02 * (1 + i % 9) as f32))
            })
            .collect();
        let rests = [
            Rest { rotation: Quat::IDENTITY, probability: 0.7 },
            Rest { rotation: Quat::from_rotation_x(std::f32::consts::FRAC_PI_2), probability: 0.3 },
        ];
        let items: Vec<Item<'_>> = models.iter().map(|model| Item { model, rests: &rests }).collect();
        for seed in 0..6 {
            let placed = place(&items, &surface(), &mut ChaCha8Rng::seed_from_u64(seed)).unwrap();
            // From the vertices where they came to lie, not from the footprints that were compared.
            let shapes: Vec<Vec<Vec3>> = models
                .iter()
                .zip(&placed)
                .map(|(m, p)| m.meshes[0].positions.iter().map(|v| p.transform().transform_point3(*v)).collect())
                .collect();
            let hulls: Vec<Vec<Vec2>> = shapes.iter().map(|s| convex_hull(s.iter().map(|v| v.truncate()))).collect();
            for (i, shape) in shapes.iter().enumerate() {
                let low = shape.iter().map(|v| v.z).fold(f32::MAX, f32::min);
                assert!((low - 0.75).abs() < 1e-4, "object {i} rests at {low}");
                assert!(shape.iter().all(|v| (v.x / 0.7).powi(2) + (v.y / 0.6).powi(2) < 1.0));
                for (j, other) in hulls.iter().enumerate().skip(i + 1) {
                    let gap = separation(&hulls[i], other);
                    assert!(gap > 0.0039, "seed {seed}: {i} and {j} are {gap} m apart");
                }
            }
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_layout_and_a_full_table_says_so() {
        let model = angle_piece(Vec3::new(0.3, 0.3, 0.1));
        let rests = [Rest { rotation: Quat::IDENTITY, probability: 1.0 }];
        let items = vec![Item { model: &model, rests: &rests }; 40];
        let run = |n: usize, seed| place(&items[..n], &surface(), &mut ChaCha8Rng::seed_from_u64(seed));
        assert_eq!(run(4, 5).unwrap(), run(4, 5).unwrap());
        assert!(matches!(run(40, 5), Err(PlacementError::Full { .. })));
    }

    #[test]
    fn separation_is_positive_apart_and_negative_when_overlapping() {
        let square = convex_hull([Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y, Vec2::splat(0.5), Vec2::new(0.5, 0.0)]);
        assert_eq!(square.len(), 4);
        let moved = |d: Vec2| square.iter().map(|p| *p + d).collect::<Vec<_>>();
        assert!((separation(&square, &moved(Vec2::new(1.25, 0.0))) - 0.25).abs() < 1e-6);
        assert!((separation(&square, &moved(Vec2::new(0.75, 0.1))) + 0.25).abs() < 1e-6);
    }
}
