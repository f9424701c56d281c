//! How a thing comes to rest on a table: stable faces of its convex hull.
//!
//! A rigid body set down gently, in a uniformly random orientation, touches first with the hull
//! face that its centre of mass projects through, then rolls over edges, always lowering its
//! centre of mass, until that projects inside the face it stands on. The probability of a pose
//! is the solid angle, seen from the centre of mass, of the faces that end in it.

use std::collections::HashMap;

use fuse_render::Model;
use glam::{DQuat, DVec3, Quat, Vec3};

use super::finish::density;
use super::hull::{Hull, sides};
use crate::catalogue::RestingPose;

/// Poses closer than this are one, degrees.
const ALIKE: f64 = 20.0;
/// Poses rarer than this are left out.
const RARE: f64 = 0.01;
/// At most so many poses.
const MOST: usize = 12;
/// The model's own pose is meant when a stable face lies within this of it, degrees.
const OWN: f64 = 12.0;

/// Centre of mass of a model of closed solids, each filled at the density of its material;
/// `None` when nothing is enclosed.
pub fn centre_of_mass(model: &Model) -> Option<Vec3> {
    let (mut mass, mut moment) = (0.0f64, DVec3::ZERO);
    for mesh in &model.meshes {
        let weight = f64::from(density(model.materials.get(mesh.material).map_or("", |m| m.name.as_str())));
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize].as_dvec3());
            let m = weight * a.dot(b.cross(c)) / 6.0;
            mass += m;
            moment += m * (a + b + c) / 4.0;
        }
    }
    (mass > 1e-9).then(|| (moment / mass).as_vec3())
}

/// A stable support: the direction that points down, and its share of throws.
struct Support {
    down: DVec3,
    area: f64,
    share: f64,
}

/// All stable supports of a hull, most probable first; near-equal ones are merged.
fn supports(hull: &Hull, centre: DVec3) -> Vec<Support> {
    let mut across: HashMap<(usize, usize), usize> = HashMap::new();
    for (i, f) in hull.faces.iter().enumerate() {
        for (a, b) in sides(*f) {
            across.insert((a, b), i);
        }
    }
    let mut share = vec![0.0f64; hull.faces.len()];
    for (i, face) in hull.faces.iter().enumerate() {
        share[roll(hull, &across, centre, i)] += solid_angle(face.map(|p| hull.points[p] - centre));
    }
    let whole: f64 = share.iter().sum();
    let mut found: Vec<Support> = vec![];
    let mut order: Vec<usize> = (0..share.len()).filter(|&i| share[i] > 0.0).collect();
    order.sort_by(|&i, &j| share[j].total_cmp(&share[i]).then(i.cmp(&j)));
    for i in order {
        let (down, area) = hull.plane(hull.faces[i]);
        let s = share[i] / whole;
        match found.iter_mut().find(|f| f.down.dot(down) > ALIKE.to_radians().cos()) {
            Some(near) => {
                near.share += s;
                // Coplanar triangles differ by the hull's jitter; the larger is the truer.
                if area > near.area && near.down.dot(down) > 1f64.to_radians().cos() {
                    (near.down, near.area) = (down, area);
                }
            }
            None => found.push(Support { down, area, share: s }),
        }
    }
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    found
}

/// Signed solid angle of a triangle seen from the origin (Van Oosterom and Strackee).
fn solid_angle([a, b, c]: [DVec3; 3]) -> f64 {
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    2.0 * a.dot(b.cross(c)).atan2(below)
}

/// The face on which the body ends that starts on face `i`.
fn roll(hull: &Hull, across: &HashMap<(usize, usize), usize>, centre: DVec3, mut i: usize) -> usize {
    for _ in 0..hull.faces.len() {
        let f = hull.faces[i];
        let (normal, _) = hull.plane(f);
        let beyond = sides(f).map(|(a, b)| {
            let inward = normal.cross((hull.points[b] - hull.points[a]).normalize_or_zero());
            (-(centre - hull.points[a]).dot(inward), (b, a))
        });
        let worst = beyond.iter().max_by(|a, b| a.0.total_cmp(&b.0)).copied().unwrap_or((0.0, (0, 0)));
        match across.get(&worst.1) {
            Some(&next) if worst.0 > 0.0 => i = next,
            _ => return i,
        }
    }
    i
}

/// The rotation that turns `down` to -z and else turns as little as possible.
fn upright(down: DVec3) -> DQuat {
    if down.z < -1.0 + 1e-12 { DQuat::IDENTITY } else { DQuat::from_rotation_arc(down, DVec3::NEG_Z) }
}

fn lowest(model: &Model, rotation: Quat) -> f32 {
    model.meshes.iter().flat_map(|m| &m.positions).map(|p| (rotation * *p).z).fold(f32::MAX, f32::min)
}

/// Points beyond which a model's are thinned before its hull is computed.
const MANY_POINTS: usize = 20_000;
/// Cells of the grid that thins them, along the longest side.
const CELLS: f32 = 200.0;

/// The convex hull of a model; of very many points, that of the farthest from the middle in each
/// cell of a fine grid.
pub(super) fn hull(model: &Model) -> Option<Hull> {
    let points = || model.meshes.iter().flat_map(|m| m.positions.iter().copied());
    if points().count() <= MANY_POINTS {
        return Hull::new(points());
    }
    let (low, high) = model.bounds()?;
    let (middle, cell) = ((low + high) / 2.0, (high - low).max_element().max(1e-6) / CELLS);
    let mut kept: HashMap<[i32; 3], Vec3> = HashMap::new();
    for p in points() {
        let farthest = kept.entry(((p - low) / cell).to_array().map(|v| v as i32)).or_insert(p);
        if p.distance_squared(middle) > farthest.distance_squared(middle) {
            *farthest = p;
        }
    }
    let mut kept: Vec<_> = kept.into_iter().collect();
    kept.sort_by_key(|k| k.0);
    Hull::new(kept.into_iter().map(|k| k.1))
}

fn hull_of(model: &Model) -> Option<(Hull, DVec3)> {
    Some((hull(model)?, centre_of_mass(model)?.as_dvec3()))
}

/// Stable poses of a model, most probable first; probabilities sum to 1. The pose nearest to
/// the model's own gets the share `natural`, the others the rest in proportion to their solid
/// angles. A model that encloses no volume keeps its own pose.
pub fn resting_poses(model: &Model, natural: f32) -> Vec<RestingPose> {
    let found = hull_of(model).map_or_else(Vec::new, |(hull, centre)| supports(&hull, centre));
    poses(model, found, Some(f64::from(natural)))
}

/// Stable poses of a model with a given centre of mass, most probable first, each with the share of
/// throws that end in it; shares sum to 1. With `natural`, the model's own pose has that share if it
/// is stable. A model that spans no volume keeps its own pose.
pub fn foreign_poses(model: &Model, centre: DVec3, natural: Option<f32>) -> Vec<RestingPose> {
    let found = hull(model).map_or_else(Vec::new, |hull| supports(&hull, centre));
    poses(model, found, natural.map(f64::from))
}

/// Records of supports; the model's own pose gets the share `natural`, if that is given.
fn poses(model: &Model, found: Vec<Support>, natural: Option<f64>) -> Vec<RestingPose> {
    let own =
        found.iter().position(|s| s.down.dot(DVec3::NEG_Z) > OWN.to_radians().cos()).filter(|_| natural.is_some());
    let mut kept: Vec<(DVec3, f64)> = vec![];
    let natural = natural.unwrap_or(0.0);
    let others: f64 = found.iter().enumerate().filter(|&(i, _)| Some(i) != own).map(|(_, s)| s.share).sum();
    for (i, support) in found.iter().enumerate() {
        let share = match own {
            Some(o) if o == i => natural.max(1e-3),
            Some(_) => (1.0 - natural) * support.share / others.max(1e-12),
            None => support.share,
        };
        if share >= RARE || Some(i) == own {
            kept.push((support.down, share));
        }
    }
    kept.sort_by(|a, b| b.1.total_cmp(&a.1));
    kept.truncate(MOST);
    if kept.is_empty() {
        kept.push((DVec3::NEG_Z, 1.0));
    }
    let whole: f64 = kept.iter().map(|k| k.1).sum();
    kept.iter()
        .map(|&(down, share)| {
            let rotation = upright(down).as_quat().normalize();
            RestingPose {
                quaternion: rotation.to_array(),
                height: 0.0 - lowest(model, rotation),
                probability: (share / whole) as f32,
            }
        })
        .collect()
}

/// Turns a model, as little as possible, into the stable pose nearest to its own, puts it on
/// z = 0 and its footprint's centre on the origin.
pub fn settle(model: &mut Model) {
    let rotation = hull_of(model)
        .and_then(|(hull, centre)| {
            supports(&hull, centre).into_iter().map(|s| s.down).min_by(|a, b| a.z.total_cmp(&b.z))
        })
        .map_or(Quat::IDENTITY, |down| upright(down).as_quat().normalize());
    for mesh in &mut model.meshes {
        mesh.positions.iter_mut().for_each(|p| *p = rotation * *p);
        mesh.normals.iter_mut().for_each(|n| *n = (rotation * *n).normalize());
    }
    let Some((low, high)) = model.bounds() else { return };
    let shift = Vec3::new(-(low.x + high.x) / 2.0, -(low.y + high.y) / 2.0, -low.z);
    model.meshes.iter_mut().flat_map(|m| &mut m.positions).for_each(|p| *p += shift);
}
