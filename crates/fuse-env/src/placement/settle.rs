//! Rigid-body settling: things are let go a little above where they shall lie and come to rest.
//!
//! One thread, fixed steps, and an engine built for equal bits on every machine: the result is a
//! function of the arguments alone.

use glam::Vec2;
use rapier3d::glamx::{Quat, Vec3};
use rapier3d::math::Pose;
use rapier3d::prelude::{ColliderBuilder, PhysicsWorld, RigidBodyBuilder, RigidBodyHandle, SharedShape};

use super::solid::Solid;

/// Step of the simulation, seconds.
const STEP_S: f32 = 1.0 / 200.0;
/// Time after which things that still move make a layout fail, seconds.
const LONGEST_S: f32 = 4.0;
/// Time over which everything must be still, seconds.
const STILL_S: f32 = 0.2;
/// Movement of any point over that time that counts as still, metres.
const STILL_M: f32 = 1e-4;
/// Coulomb friction of everything against everything.
const FRICTION: f32 = 0.7;
/// Thickness of the table top, metres.
const TOP_M: f32 = 0.1;

/// The table that things are settled on.
#[derive(Clone, Debug)]
pub struct Top {
    /// Convex outline, counter-clockwise, world metres.
    pub outline: Vec<Vec2>,
    /// Height, metres.
    pub height: f32,
}

impl Top {
    /// The table top as a convex solid.
    pub fn shape(&self) -> Option<SharedShape> {
        let points: Vec<Vec3> = self
            .outline
            .iter()
            .flat_map(|p| [self.height - TOP_M, self.height].map(|z| Vec3::new(p.x, p.y, z)))
            .collect();
        SharedShape::convex_hull(&points)
    }
}

/// Why things did not settle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unsettled {
    /// Something left the table.
    #[error("something fell off the table")]
    Fell,
    /// Something still moved after the time that was given.
    #[error("something does not come to rest")]
    Moving,
    /// The table has no area.
    #[error("the table top has no area")]
    NoTable,
}

/// Lets `things` go at their poses (world from model, metres) and follows them until all are still.
/// Returns where they came to rest.
///
/// # Errors
/// [`Unsettled`] when something falls off or keeps moving.
pub fn settle(top: &Top, things: &[(&Solid, Pose)]) -> Result<Vec<Pose>, Unsettled> {
    let (mut world, handles) = built(top, things)?;
    let radius: Vec<f32> = things.iter().map(|(s, _)| s.size().length()).collect();
    let still_steps = (STILL_S / STEP_S).round() as usize;
    let mut before = poses(&world, &handles);
    for step in 1..=(LONGEST_S / STEP_S).round() as usize {
        world.step();
        if step % still_steps != 0 {
            continue;
        }
        let now = poses(&world, &handles);
        if now.iter().any(|p| !p.translation.is_finite() || p.translation.z < top.height - 0.05) {
            return Err(Unsettled::Fell);
        }
        let moved = now.iter().zip(&before).zip(&radius).map(|((a, b), r)| motion(a, b, *r)).fold(0.0, f32::max);
        if moved < STILL_M {
            return Ok(now);
        }
        before = now;
    }
    Err(Unsettled::Moving)
}

/// How far a body of a size moved at most between two poses, metres.
pub fn motion(a: &Pose, b: &Pose, size: f32) -> f32 {
    let turned = a.rotation.inverse() * b.rotation;
    let sine = Vec3::new(turned.x, turned.y, turned.z).length();
    a.translation.distance(b.translation) + 2.0 * sine * size
}

/// How far anything moves within `seconds` when it is let go at its pose, metres.
///
/// # Errors
/// [`Unsettled`] when there is no table.
pub fn drift(top: &Top, things: &[(&Solid, Pose)], seconds: f32) -> Result<f32, Unsettled> {
    let (mut world, handles) = built(top, things)?;
    for _ in 0..(seconds / STEP_S) as usize {
        world.step();
    }
    let now = poses(&world, &handles);
    Ok(now.iter().zip(things).map(|(p, (s, was))| motion(was, p, s.size().length())).fold(0.0, f32::max))
}

fn poses(world: &PhysicsWorld, handles: &[RigidBodyHandle]) -> Vec<Pose> {
    handles.iter().filter_map(|h| world.bodies.get(*h)).map(|b| *b.position()).collect()
}

fn built(top: &Top, things: &[(&Solid, Pose)]) -> Result<(PhysicsWorld, Vec<RigidBodyHandle>), Unsettled> {
    let mut world = PhysicsWorld::new();
    world.gravity = Vec3::new(0.0, 0.0, -9.81);
    let p = &mut world.integration_parameters;
    p.dt = STEP_S;
    // Things are centimetres in size: slop and speculative margin a tenth of what metres would need.
    p.length_unit = 0.05;
    p.num_solver_iterations = 8;
    world.insert_collider(ColliderBuilder::new(top.shape().ok_or(Unsettled::NoTable)?).friction(FRICTION), None);
    let handles = things
        .iter()
        .map(|(solid, pose)| {
            let body = RigidBodyBuilder::dynamic().pose(*pose).linear_damping(0.6).angular_damping(2.5).can_sleep(true);
            let collider = ColliderBuilder::new(solid.compound.clone())
                .friction(FRICTION)
                .restitution(0.0)
                .mass_properties(solid.mass);
            world.insert(body, collider).0
        })
        .collect();
    Ok((world, handles))
}

/// A pose from glam's own types.
pub fn pose(rotation: glam::Quat, translation: glam::Vec3) -> Pose {
    Pose::from_parts(Vec3::from_array(translation.to_array()), Quat::from_array(rotation.to_array()))
}
