//! Rigid-body settling: things are let go a little above where they shall lie and come to rest.
//!
//! One thread, fixed steps, and an engine built for equal bits on every machine: the result is a
//! function of the arguments alone.

use glam::Vec2;
use rapier3d::dynamics::MassProperties;
use rapier3d::geometry::HalfSpace;
use rapier3d::glamx::{Quat, Vec3};
use rapier3d::math::Pose;
use rapier3d::prelude::{
    ColliderBuilder, PhysicsWorld, RigidBodyBuilder, RigidBodyHandle, SharedShape, SpringCoefficients,
};

use super::solid::Solid;
use super::units::{PER_METRE, to_engine, to_metres};

/// Step of the simulation, seconds.
const STEP_S: f32 = 1.0 / 400.0;
/// Time after which things that still move make a layout fail, seconds.
const LONGEST_S: f32 = 4.0;
/// Time over which everything must be still, seconds.
const STILL_S: f32 = 0.2;
/// Movement of any point over that time that counts as still, metres.
const STILL_M: f32 = 3e-4;
/// Time after which rocking is damped strongly, seconds: what is unstable has fallen by then.
const CALM_S: f32 = 0.8;
/// Times that things are let go anew until they stay where they are.
const ROUNDS: usize = 8;
/// Movement of any point after letting go anew that counts as none, metres.
const STEADY_M: f32 = 1e-3;
/// Time for which things must stay where they are in the end, seconds, and how far any point may move in it, metres.
const STAY_S: f32 = 1.0;
const STAY_M: f32 = 3e-3;
/// Speed (m/s), angular speed (rad/s) and time (s) at which the engine takes a group to be at rest.
const SLEEP: (f32, f32, f32) = (0.004, 0.1, 0.25);
/// Size of things, metres: slop, speculative margin and speeds of rest are a fifth of what a metre would need.
const THING_M: f32 = 0.2;
/// Coulomb friction of everything against everything.
const FRICTION: f32 = 0.7;

/// The table that things are settled on.
#[derive(Clone, Debug)]
pub struct Top {
    /// Convex outline, counter-clockwise, world metres.
    pub outline: Vec<Vec2>,
    /// Height, metres.
    pub height: f32,
}

impl Top {
    /// Whether a point is above the table top.
    pub fn contains(&self, p: Vec3) -> bool {
        let n = self.outline.len();
        (0..n).all(|i| {
            let (s, e) = (self.outline[i], self.outline[(i + 1) % n]);
            (e - s).perp_dot(Vec2::new(p.x, p.y) - s) > 0.0
        })
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
}

/// Lets `things` go at their poses (world from model, metres) and follows them until all are still.
/// Returns where they came to rest.
///
/// # Errors
/// [`Unsettled`] when something falls off or keeps moving.
pub fn settle(top: &Top, things: &[(&Solid, Pose)]) -> Result<Vec<Pose>, Unsettled> {
    let mut now = let_go(top, things)?;
    for _ in 0..ROUNDS {
        // What rests only by the impulses of the steps before moves when it is let go anew.
        let again: Vec<(&Solid, Pose)> = things.iter().zip(&now).map(|(t, p)| (t.0, *p)).collect();
        let next = let_go(top, &again)?;
        let steady = again.iter().zip(&next).all(|((s, was), is)| motion(was, is, s.size().length()) < STEADY_M);
        now = next;
        // What tips over slowly looks still at first, and what is about to stays only for one order of the solver.
        let mut again: Vec<(&Solid, Pose)> = things.iter().zip(&now).map(|(t, p)| (t.0, *p)).collect();
        let mut stays = || {
            again.reverse();
            drift(top, &again, STAY_S) < STAY_M
        };
        if steady && stays() && stays() {
            return Ok(now);
        }
    }
    Err(Unsettled::Moving)
}

/// Follows things until all are still.
fn let_go(top: &Top, things: &[(&Solid, Pose)]) -> Result<Vec<Pose>, Unsettled> {
    let (mut world, handles) = built(top, things);
    let radius: Vec<f32> = things.iter().map(|(s, _)| s.size().length()).collect();
    let still_steps = (STILL_S / STEP_S).round() as usize;
    let mut before = poses(&world, &handles);
    for step in 1..=(LONGEST_S / STEP_S).round() as usize {
        world.step();
        if step % still_steps != 0 {
            continue;
        }
        if step as f32 * STEP_S >= CALM_S {
            calm(&mut world, &handles);
        }
        let now = poses(&world, &handles);
        // The plane goes on beyond the edge; what has its centre of mass there would fall.
        let off = |(p, t): (&Pose, &(&Solid, Pose))| !top.contains(p.transform_point(t.0.mass.local_com));
        if now.iter().zip(things).any(off) {
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
pub fn drift(top: &Top, things: &[(&Solid, Pose)], seconds: f32) -> f32 {
    let (mut world, handles) = built(top, things);
    for _ in 0..(seconds / STEP_S) as usize {
        world.step();
    }
    let now = poses(&world, &handles);
    now.iter().zip(things).map(|(p, (s, was))| motion(was, p, s.size().length())).fold(0.0, f32::max)
}

/// Damps what is left of the movement: no real thing rocks on and on by tenths of a millimetre.
fn calm(world: &mut PhysicsWorld, handles: &[RigidBodyHandle]) {
    for h in handles {
        if let Some(body) = world.bodies.get_mut(*h) {
            body.set_linear_damping(4.0);
            body.set_angular_damping(15.0);
        }
    }
}

fn poses(world: &PhysicsWorld, handles: &[RigidBodyHandle]) -> Vec<Pose> {
    handles.iter().filter_map(|h| world.bodies.get(*h)).map(|b| to_metres(b.position())).collect()
}

/// Mass properties in grams and the engine's units: the inertia of a pencil in kg m² is below what it takes for zero.
fn in_engine(of: &MassProperties) -> MassProperties {
    let mut mass = *of;
    mass.local_com *= PER_METRE;
    mass.inv_principal_inertia /= PER_METRE * PER_METRE;
    mass.set_mass(mass.mass() * 1000.0, true);
    mass
}

fn built(top: &Top, things: &[(&Solid, Pose)]) -> (PhysicsWorld, Vec<RigidBodyHandle>) {
    let mut world = PhysicsWorld::new();
    world.gravity = Vec3::new(0.0, 0.0, -9.81 * PER_METRE);
    let p = &mut world.integration_parameters;
    p.dt = STEP_S;
    p.length_unit = THING_M * PER_METRE;
    p.num_solver_iterations = 8;
    // Fewer layouts keep moving with it (16 of 144, with shorter steps and more rounds, instead of 27).
    p.friction_in_bias_pass = true;
    // Stiff and slow to correct: soft contacts let stacks sink into one another, lively ones rock.
    let stiff = SpringCoefficients::new(100.0, 20.0);
    (p.contact_softness, p.static_contact_softness) = (stiff, stiff);
    // Contacts kept over steps are those of metre-sized things; a spoon has tipped over by then.
    p.contact_recycling = false;
    p.contact_clustering = false;
    let plane = ColliderBuilder::new(SharedShape::new(HalfSpace { normal: Vec3::Z }))
        .translation(Vec3::Z * top.height * PER_METRE);
    world.insert_collider(plane.friction(FRICTION), None);
    let handles = things
        .iter()
        .map(|(solid, pose)| {
            let body =
                RigidBodyBuilder::dynamic().pose(to_engine(pose)).linear_damping(0.6).angular_damping(2.5).build();
            let mass = in_engine(&solid.mass);
            let collider =
                ColliderBuilder::new(solid.compound.clone()).friction(FRICTION).restitution(0.0).mass_properties(mass);
            let handle = world.insert(body, collider).0;
            if let Some(body) = world.bodies.get_mut(handle) {
                let rest = body.activation_mut();
                rest.normalized_linear_threshold = SLEEP.0 / THING_M;
                rest.angular_threshold = SLEEP.1;
                rest.time_until_sleep = SLEEP.2;
            }
            handle
        })
        .collect();
    (world, handles)
}

/// A pose from glam's own types.
pub fn pose(rotation: glam::Quat, translation: glam::Vec3) -> Pose {
    Pose::from_parts(Vec3::from_array(translation.to_array()), Quat::from_array(rotation.to_array()))
}
