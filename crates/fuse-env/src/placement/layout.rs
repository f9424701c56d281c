//! Where things are let go, by clutter style: which of them stand on the table, and which stand in,
//! lie on or lean against another. The physics then decides.

mod plan;

use glam::Quat as Rotation;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rapier3d::glamx::{Quat, Vec3};
use rapier3d::math::Pose;
use rapier3d::parry::query::{ShapeCastOptions, cast_shapes};

use super::settle::{Top, pose};
use super::solid::Solid;
use super::units::{PER_METRE, to_engine};
use super::{Item, PlacementError, Rest, Surface, direction, place};
use crate::configuration::ClutterStyle;
use plan::plan;

pub use plan::{Hold, Thing};

/// Height from which things are lowered, above the table, metres.
const ABOVE: f32 = 0.9;
/// Gap at which lowering stops, metres.
const GAP: f32 = 5e-4;
/// Places that are tried for a thing on another.
const TRIES: usize = 12;
/// Poses at which things are let go (world from model, metres), and what shall hold them.
#[derive(Clone, Debug)]
pub struct Proposal {
    /// In the order of the things.
    pub poses: Vec<Pose>,
    /// `None` for what stands on the table.
    pub holds: Vec<Option<Hold>>,
}

/// A random horizontal direction.
fn level(rng: &mut ChaCha8Rng) -> Vec3 {
    let d = direction(rng);
    Vec3::new(d.x, d.y, 0.0)
}

/// A random turn about the vertical.
fn yaw(rng: &mut ChaCha8Rng) -> Quat {
    let d = direction(rng);
    Quat::from_xyzw(0.0, 0.0, d.y, d.x)
}

/// Proposes where the things are let go, the first being what the others gather around.
///
/// # Errors
/// [`PlacementError`] when the table has no room for what stands on it.
pub fn propose(
    style: ClutterStyle,
    things: &[Thing<'_>],
    surface: &Surface,
    rng: &mut ChaCha8Rng,
) -> Result<Proposal, PlacementError> {
    let mut holds = plan(style, things, rng);
    let hosts: Vec<bool> = (0..things.len())
        .map(|i| holds.iter().flatten().any(|h| matches!(h, Hold::In(k) | Hold::On(k) | Hold::Against(k) if *k == i)))
        .collect();
    let rests: Vec<Vec<Rest>> = things
        .iter()
        .zip(&hosts)
        .map(|(t, host)| if *host { vec![t.upright()] } else { t.item.rests.to_vec() })
        .collect();
    let base: Vec<usize> = (0..things.len()).filter(|&i| holds[i].is_none()).collect();
    let items: Vec<Item<'_>> = base.iter().map(|&i| Item { model: things[i].item.model, rests: &rests[i] }).collect();
    let placed = place(&items, surface, rng)?;
    let mut poses: Vec<Option<Pose>> = vec![None; things.len()];
    for (&i, p) in base.iter().zip(&placed) {
        poses[i] = Some(pose(p.rotation, p.translation + glam::Vec3::Z * GAP));
    }
    let top = Top { outline: surface.outline.clone(), height: surface.height };
    // Hosts before what they hold.
    while let Some(i) = (0..things.len()).find(|&i| {
        poses[i].is_none()
            && matches!(holds[i], Some(Hold::In(h) | Hold::On(h) | Hold::Against(h)) if poses[h].is_some())
    }) {
        let at = holds[i].and_then(|hold| hosted(i, hold, things, &rests[i], &poses, &top, rng));
        if at.is_none() {
            holds[i] = None;
        }
        poses[i] = Some(match at {
            Some(at) => at,
            None => beside(&things[i], &rests[i], things, &poses, surface, rng)
                .ok_or(PlacementError::Full { index: i, count: things.len() })?,
        });
    }
    Ok(Proposal { poses: poses.into_iter().flatten().collect(), holds })
}

/// A free place on the table for what found none where it was meant to go.
fn beside(
    thing: &Thing<'_>,
    rests: &[Rest],
    things: &[Thing<'_>],
    poses: &[Option<Pose>],
    surface: &Surface,
    rng: &mut ChaCha8Rng,
) -> Option<Pose> {
    let top = Top { outline: surface.outline.clone(), height: surface.height };
    (0..4 * TRIES).find_map(|_| {
        let turn = yaw(rng) * quat(super::pick_rest(rests, rng));
        let at = super::anywhere(surface, rng);
        let lowered = lower(thing, turn, Vec3::new(at.x, at.y, 0.0), things, poses, &top)?;
        let lowest = thing.solid.samples.iter().map(|p| lowered.transform_point(*p).z).fold(f32::MAX, f32::min);
        (lowest < surface.height + 0.002).then_some(lowered)
    })
}

fn quat(q: Rotation) -> Quat {
    Quat::from_xyzw(q.x, q.y, q.z, q.w)
}

/// Where a thing is let go so that its host holds it.
fn hosted(
    i: usize,
    hold: Hold,
    things: &[Thing<'_>],
    rests: &[Rest],
    poses: &[Option<Pose>],
    top: &Top,
    rng: &mut ChaCha8Rng,
) -> Option<Pose> {
    let thing = &things[i];
    match hold {
        Hold::In(h) => {
            let (host, at, cavity) = (&things[h], poses[h]?, things[h].solid.cavity?);
            debug_assert!(host.is_container());
            let (d, depth) = (level(rng), cavity.rim - cavity.floor);
            let (end, girth) = thing.narrow_end();
            let free = (cavity.radius - 0.5 * girth).max(0.1 * cavity.radius);
            let up = (d * free + Vec3::Z * depth).normalize();
            let turn = yaw(rng) * Quat::from_rotation_arc(-end, Vec3::Z);
            let turn = Quat::from_rotation_arc(Vec3::Z, up) * turn;
            let foot = at.transform_point(Vec3::new(cavity.axis.x, cavity.axis.y, cavity.floor)) - d * (0.5 * free);
            let end_point = tip(thing, end);
            lower(thing, turn, foot - turn * end_point, things, poses, top)
        }
        Hold::On(h) => on(thing, h, things, rests, poses, top, rng),
        Hold::Against(h) => {
            let (host, at) = (&things[h], poses[h]?);
            let height = host.solid.size().z;
            let middle = at.transform_point((host.solid.bounds[0] + host.solid.bounds[1]) / 2.0);
            (0..TRIES).find_map(|_| {
                let d = level(rng);
                let slope = rng.random_range(0.5..0.85f32);
                let up = (d * slope + Vec3::Z).normalize();
                let end = thing.heavy_end();
                let turn = Quat::from_rotation_arc(Vec3::Z, up) * (yaw(rng) * Quat::from_rotation_arc(-end, Vec3::Z));
                // The host's near edge on this side.
                let edge = host
                    .solid
                    .samples
                    .iter()
                    .map(|p| (at.transform_point(*p) - middle).dot(d))
                    .fold(f32::MAX, f32::min);
                let foot = middle + d * (edge - slope * height * 1.02 - 0.01);
                let foot = Vec3::new(foot.x, foot.y, top.height);
                let lowered = lower(thing, turn, foot - turn * tip(thing, end), things, poses, top)?;
                let lowest = lowered.transform_point(tip(thing, end)).z;
                (top.contains(lowered.transform_point(tip(thing, end))) && lowest < top.height + 0.03)
                    .then_some(lowered)
            })
        }
    }
}

/// A place on a host that is free of what is there already, or, in a stack, on top of that.
fn on(
    thing: &Thing<'_>,
    h: usize,
    things: &[Thing<'_>],
    rests: &[Rest],
    poses: &[Option<Pose>],
    top: &Top,
    rng: &mut ChaCha8Rng,
) -> Option<Pose> {
    let (host, at) = (&things[h], poses[h]?);
    let same = thing.category == host.category;
    let rest = if same { thing.upright().rotation } else { super::pick_rest(rests, rng) };
    let half = host.solid.cavity.map_or(host.solid.size() / 2.0, |c| Vec3::new(c.half.x, c.half.y, 0.0));
    let middle = host
        .solid
        .cavity
        .map_or((host.solid.bounds[0] + host.solid.bounds[1]) / 2.0, |c| Vec3::new(c.axis.x, c.axis.y, 0.0));
    let mut best: Option<(f32, Pose)> = None;
    for _ in 0..TRIES {
        let turn = if same { at.rotation } else { yaw(rng) * quat(rest) };
        let own = turned_half(thing.solid, at.rotation.inverse() * turn);
        let room = (half - own).max(Vec3::ZERO);
        let spread = |rng: &mut ChaCha8Rng| 2.0 * rng.random::<f32>() - 1.0;
        let offset = Vec3::new(spread(rng) * room.x, spread(rng) * room.y, 0.0) * if same { 0.1 } else { 0.85 };
        let target = at.transform_point(middle + offset);
        let own_middle = turn * ((thing.solid.bounds[0] + thing.solid.bounds[1]) / 2.0);
        let Some(lowered) = lower(thing, turn, target - own_middle, things, poses, top) else { continue };
        // The lowest place is the one where nothing is yet.
        if best.as_ref().is_none_or(|b| lowered.translation.z < b.0) {
            best = Some((lowered.translation.z, lowered));
        }
        if same {
            break;
        }
    }
    best.map(|b| b.1)
}

/// Half the extent of a turned body along the axes.
fn turned_half(solid: &Solid, turn: Quat) -> Vec3 {
    let half = solid.size() / 2.0;
    let [x, y, z] = [Vec3::X * half.x, Vec3::Y * half.y, Vec3::Z * half.z].map(|v| (turn * v).abs());
    x + y + z
}

/// The middle of the end face of a body along an axis direction.
fn tip(thing: &Thing<'_>, end: Vec3) -> Vec3 {
    let [low, high] = thing.solid.bounds;
    let middle = (low + high) / 2.0;
    middle + end * (high - low) / 2.0
}

/// The pose in which a turned thing, lowered at an x and y, first touches something.
fn lower(
    thing: &Thing<'_>,
    turn: Quat,
    at: Vec3,
    things: &[Thing<'_>],
    poses: &[Option<Pose>],
    top: &Top,
) -> Option<Pose> {
    let start = Pose::from_parts(Vec3::new(at.x, at.y, top.height + ABOVE), turn);
    let lowest = thing.solid.samples.iter().map(|p| start.transform_point(*p).z).fold(f32::MAX, f32::min);
    let mut fall = lowest - top.height;
    // At one metre a unit of time.
    let options =
        ShapeCastOptions { max_time_of_impact: fall, target_distance: GAP * PER_METRE, ..ShapeCastOptions::default() };
    for (other, pose) in things.iter().zip(poses) {
        let Some(pose) = pose else { continue };
        let hit = cast_shapes(
            &to_engine(&start),
            -Vec3::Z * PER_METRE,
            thing.solid.compound.as_ref(),
            &to_engine(pose),
            Vec3::ZERO,
            other.solid.compound.as_ref(),
            options,
        );
        if let Ok(Some(hit)) = hit {
            fall = fall.min(hit.time_of_impact);
        }
    }
    (fall > 0.0).then(|| Pose::from_parts(start.translation - Vec3::Z * (fall - GAP), turn))
}

/// Share of the things that are still held as they were meant to be; 1 when none is held.
pub fn kept(proposal: &Proposal, things: &[Thing<'_>], settled: &[Pose], table: f32) -> f32 {
    let held: Vec<(usize, Hold)> = proposal.holds.iter().enumerate().filter_map(|(i, h)| h.map(|h| (i, h))).collect();
    if held.is_empty() {
        return 1.0;
    }
    let good =
        held.iter().filter(|(i, hold)| is_held(&things[*i], &settled[*i], *hold, things, settled, table)).count();
    good as f32 / held.len() as f32
}

fn is_held(thing: &Thing<'_>, at: &Pose, hold: Hold, things: &[Thing<'_>], settled: &[Pose], table: f32) -> bool {
    let (axis, ..) = thing.length();
    let mut along = Vec3::ZERO;
    along[axis] = 1.0;
    let steep = (at.rotation * along).z.abs();
    let lowest = thing.solid.samples.iter().map(|p| at.transform_point(*p).z).fold(f32::MAX, f32::min);
    match hold {
        Hold::In(h) => {
            let (end, _) = thing.narrow_end();
            let Some(c) = things[h].solid.cavity else { return false };
            let foot = settled[h].inv_mul(at).transform_point(tip(thing, end));
            foot.z < c.rim && (foot.x - c.axis.x).hypot(foot.y - c.axis.y) < 1.3 * c.radius && steep > 0.4
        }
        Hold::On(_) => lowest > table + 0.002,
        Hold::Against(_) => steep > 0.25 && lowest < table + 0.02,
    }
}
