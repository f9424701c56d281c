//! Whether a settled layout is sound, judged by the true meshes.

use rapier3d::geometry::{PointQuery, Ray, RayCast, TriMesh};
use rapier3d::glamx::Vec3;
use rapier3d::math::Pose;
use rapier3d::parry::query::contact;
use rapier3d::parry::shape::FeatureId;

use super::settle::Top;
use super::solid::Solid;
use super::units::{PER_METRE, to_engine};

/// Penetration from which a layout is thrown away, metres.
pub const PENETRATION_M: f32 = 0.002;
/// How far anything may hang over the table's edge, metres.
pub const OVERHANG_M: f32 = 0.02;

/// What is wrong with a layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unsound {
    /// Two things, or a thing and the table, are in one another.
    #[error("objects interpenetrate")]
    Penetration,
    /// Something hangs over the edge.
    #[error("something hangs over the table's edge")]
    Overhang,
}

/// Checks a layout (world from model, metres).
///
/// # Errors
/// [`Unsound`] for what is wrong.
pub fn check(top: &Top, things: &[(&Solid, Pose)]) -> Result<(), Unsound> {
    let inward = edges(top);
    for (solid, pose) in things {
        for p in &solid.samples {
            let p = pose.transform_point(*p);
            if p.z < top.height - PENETRATION_M {
                return Err(Unsound::Penetration);
            }
            if inward.iter().any(|(normal, offset)| normal.dot(p) - offset < -OVERHANG_M) {
                return Err(Unsound::Overhang);
            }
        }
    }
    for (i, a) in things.iter().enumerate() {
        for b in &things[i + 1..] {
            if penetration(*a, *b, PENETRATION_M) > PENETRATION_M || crossing(*a, *b) > PENETRATION_M {
                return Err(Unsound::Penetration);
            }
        }
    }
    Ok(())
}

/// Inward normals of the table's edges and their offsets.
fn edges(top: &Top) -> Vec<(Vec3, f32)> {
    let n = top.outline.len();
    (0..n)
        .map(|i| {
            let (s, e) = (top.outline[i], top.outline[(i + 1) % n]);
            let normal = Vec3::new(s.y - e.y, e.x - s.x, 0.0).normalize_or_zero();
            (normal, normal.dot(Vec3::new(s.x, s.y, 0.0)))
        })
        .collect()
}

/// How deep the surface of one thing lies inside of the other, metres; as soon as more than `enough`
/// is found, that is returned. Measured at the samples of both against each closed part of the other.
pub fn penetration(a: (&Solid, Pose), b: (&Solid, Pose), enough: f32) -> f32 {
    let one_way = |(of, at): (&Solid, Pose), (into, there): (&Solid, Pose), found: f32| {
        let relative = there.inv_mul(&at);
        let mut deepest = found;
        for p in &of.samples {
            let p = relative.transform_point(*p);
            let [low, high] = into.bounds;
            if p.cmplt(low).any() || p.cmpgt(high).any() {
                continue;
            }
            for part in &into.parts {
                deepest = deepest.max(depth(part, p, deepest));
                if deepest > enough {
                    return deepest;
                }
            }
        }
        deepest
    };
    let found = one_way(a, b, 0.0);
    if found > enough { found } else { one_way(b, a, found) }
}

/// Depth of a point in a closed part, 0 outside or when it is not deeper than `known`.
fn depth(part: &TriMesh, p: Vec3, known: f32) -> f32 {
    let bounds = part.local_aabb();
    let into = (p - bounds.mins).min(bounds.maxs - p).min_element();
    if into <= known {
        return 0.0;
    }
    let nearest = part.project_local_point(p, false);
    let deep = nearest.point.distance(p);
    if nearest.is_inside && deep > known && encloses(part, p) { deep } else { 0.0 }
}

/// Whether a closed part encloses a point, by what is first seen from there: where triangles are thin
/// slivers, the side of the nearest one is not to be trusted.
fn encloses(part: &TriMesh, p: Vec3) -> bool {
    let leaves = |direction: Vec3| {
        let ray = Ray::new(p, direction);
        part.cast_local_ray_and_get_normal(&ray, 10.0, false).is_some_and(|hit| {
            let faces = part.indices();
            let FeatureId::Face(face) = hit.feature else { return false };
            let [a, b, c] = faces[face as usize % faces.len()].map(|i| part.vertices()[i as usize]);
            (b - a).cross(c - a).dot(direction) > 0.0
        })
    };
    [Vec3::new(0.36, 0.48, 0.8), Vec3::new(-0.48, 0.6, -0.64), Vec3::new(0.6, -0.64, 0.48)].into_iter().all(leaves)
}

/// How far two things must be moved apart where convex pieces of theirs are in one another, metres:
/// finds what has gone right through a thin wall, where no point is deep inside. The pieces hold
/// their meshes, so this is never too little.
pub fn crossing(a: (&Solid, Pose), b: (&Solid, Pose)) -> f32 {
    let found = contact(&to_engine(&a.1), a.0.compound.as_ref(), &to_engine(&b.1), b.0.compound.as_ref(), 0.0);
    found.ok().flatten().map_or(0.0, |c| (-c.dist / PER_METRE).max(0.0))
}
