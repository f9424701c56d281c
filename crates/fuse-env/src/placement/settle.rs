//! Rigid-body settling: things are let go a little above where they shall lie and come to rest.
//!
//! One thread, fixed steps, and an engine built for equal bits on every machine: the result is a
//! function of the arguments alone.

use glam::Vec2;
use rapier3d::glamx::{Quat, Vec3};
use rapier3d::geometry::HalfSpace;
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
    let (mut world, handles) = built(top, things);
    let radius: Vec<f32> = things.iter().map(|(s, _)| s.size().length()).collect();
    let still_steps = (STILL_S / STEP_S).round() as usize;
    let mut before = poses(&world, &handles);
    for step in 1..=(LONGEST_S / STEP_S).round() as usize {
        world.step();
        if step % still_steps != 0 {
            continue;
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
    if std::env::var("DBG").is_ok() { world.step(); let now=poses(&world,&handles); for (i,(a,b)) in now.iter().zip(&before).enumerate() { let m=motion(a,b,0.0); let n=motion(a,b,radius[i]); if n>1e-4 {let v=world.bodies[handles[i]].vels(); println!("   body {i} m {:.4} step lin {m:.6} tot {n:.6} v {:?} w {:?} sleeping {}", things[i].0.mass.mass(), v.linvel, v.angvel, world.bodies[handles[i]].is_sleeping());} } println!(); }
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

fn poses(world: &PhysicsWorld, handles: &[RigidBodyHandle]) -> Vec<Pose> {
    handles.iter().filter_map(|h| world.bodies.get(*h)).map(|b| *b.position()).collect()
}

fn built(top: &Top, things: &[(&Solid, Pose)]) -> (PhysicsWorld, Vec<RigidBodyHandle>) {
    let mut world = PhysicsWorld::new();
    world.gravity = Vec3::new(0.0, 0.0, -9.81);
    let p = &mut world.integration_parameters;
    p.dt = STEP_S;
    // Things are centimetres in size: slop and speculative margin a tenth of what metres would need.
    p.length_unit = 0.05;
    let e = |n: &str, d: f32| std::env::var(n).map_or(d, |s| s.parse().unwrap());
    p.num_solver_iterations = e("ITER", 8.0) as usize;
    p.dt = 1.0 / e("HZ", 200.0);
    p.length_unit = e("LU", 0.05);
    p.contact_recycling = e("REC", 0.0) > 0.0;
    p.contact_clustering = e("CLU", 0.0) > 0.0;
    p.normalized_prediction_distance = e("PRED", 0.02);
    if e("COUL", 0.0) > 0.0 { p.friction_model = rapier3d::prelude::FrictionModel::Coulomb; }
    p.static_contact_softness.natural_frequency = e("SF", 120.0);
    p.static_contact_softness.damping_ratio = e("SD", 10.0);
    p.contact_softness.natural_frequency = e("CF", 60.0);
    p.contact_softness.damping_ratio = e("CD", 10.0);
    p.warmstart_coefficient = e("WARM", 1.0);
    let plane = ColliderBuilder::new(SharedShape::new(HalfSpace { normal: Vec3::Z })).translation(Vec3::Z * top.height);
    world.insert_collider(plane.friction(FRICTION), None);
    let handles = things
        .iter()
        .map(|(solid, pose)| {
            let body = RigidBodyBuilder::dynamic().pose(*pose).linear_damping(e("LD",0.6)).angular_damping(e("AD",2.5)).can_sleep(true);
            let collider = ColliderBuilder::new(solid.compound.clone())
                .friction(FRICTION)
                .restitution(0.0)
                .mass_properties({let mut m = solid.mass; m.set_mass(m.mass() * std::env::var("MASS").map_or(1000.0, |s| s.parse().unwrap()), true); m});
            let handle = world.insert(body, collider).0;
            if let Some(body) = world.bodies.get_mut(handle) {
                let rest = body.activation_mut();
                rest.normalized_linear_threshold = e("LT", 0.08);
                rest.angular_threshold = e("AT", 0.1);
                rest.time_until_sleep = e("TS", 0.25);
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
