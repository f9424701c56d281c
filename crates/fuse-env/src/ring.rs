//! The viewpoints: 36 nodes along an ellipse times three downward pitches (supplement, "Viewpoints
//! and actions").
//!
//! Node `k` is at angle `2πk/36`, counter-clockwise from +x seen from above; the camera faces the
//! ellipse's centre horizontally, so `Δp > 0` moves towards its own right.

use std::f64::consts::TAU;

use fuse_camera::{ACTION_COUNT, Action, Camera, Pinhole, Pose};
use nalgebra::Point3;

use crate::configuration::{Ellipse, SceneConfiguration};

/// Positions along the ellipse.
pub const NODES: u32 = 36;
/// Downward pitches, degrees, by index.
pub const PITCHES_DEG: [f64; 3] = [15.0, 30.0, 45.0];
/// Number of viewpoints.
pub const VIEWPOINTS: usize = NODES as usize * PITCHES_DEG.len();
/// Image width, pixels.
pub const WIDTH: u32 = 640;
/// Image height, pixels.
pub const HEIGHT: u32 = 480;
/// Horizontal field of view, degrees.
pub const FOV_DEG: f64 = 60.0;
/// Nodes relative to the start, all at pitch index 1, whose views start the map.
pub const SEED_OFFSETS: [i32; 4] = [-2, -1, 1, 2];
/// Pitch index of the seed views.
pub const SEED_PITCH: u32 = 1;

/// A viewpoint or an action that does not exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RingError {
    /// Node or pitch out of range.
    #[error("viewpoint (node {node}, pitch index {pitch}) does not exist: node must be 0 to 35, pitch index 0 to 2")]
    Viewpoint {
        /// Node found.
        node: u32,
        /// Pitch index found.
        pitch: u32,
    },
    /// Action out of range.
    #[error("action must be 0 to 14, found {0}")]
    Action(usize),
    /// Action that leaves the three pitches.
    #[error("action {action} is not possible at pitch index {pitch}: it would leave 0 to 2")]
    Masked {
        /// Action index.
        action: usize,
        /// Pitch index of the viewpoint.
        pitch: u32,
    },
}

/// Where the camera is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Viewpoint {
    node: u32,
    pitch: u32,
}

impl Viewpoint {
    /// Checked constructor: `node` in 0..36, `pitch` index in 0..3.
    pub fn new(node: u32, pitch: u32) -> Result<Self, RingError> {
        if node < NODES && (pitch as usize) < PITCHES_DEG.len() {
            return Ok(Self { node, pitch });
        }
        Err(RingError::Viewpoint { node, pitch })
    }

    /// All viewpoints, by [`Viewpoint::index`].
    pub fn all() -> impl Iterator<Item = Self> {
        (0..VIEWPOINTS as u32).map(|i| Self { node: i / 3, pitch: i % 3 })
    }

    /// Node in 0..36.
    pub fn node(self) -> u32 {
        self.node
    }

    /// Pitch index in 0..3.
    pub fn pitch(self) -> u32 {
        self.pitch
    }

    /// Position in the list of all viewpoints: `3 node + pitch`.
    pub fn index(self) -> usize {
        (self.node * 3 + self.pitch) as usize
    }

    /// The viewpoint after `action`; `None` when it would leave the three pitches. Nodes wrap around.
    pub fn after(self, action: Action) -> Option<Self> {
        let pitch = self.pitch as i32 + i32::from(action.pitch);
        let node = (self.node as i32 + i32::from(action.ring)).rem_euclid(NODES as i32);
        (0..PITCHES_DEG.len() as i32).contains(&pitch).then_some(Self { node: node as u32, pitch: pitch as u32 })
    }

    /// The viewpoint after the action with this index.
    pub fn apply(self, action: usize) -> Result<Self, RingError> {
        let step = Action::from_index(action).ok_or(RingError::Action(action))?;
        self.after(step).ok_or(RingError::Masked { action, pitch: self.pitch })
    }

    /// Which of the 15 actions are possible from here.
    pub fn action_mask(self) -> [bool; ACTION_COUNT] {
        std::array::from_fn(|i| Action::from_index(i).and_then(|a| self.after(a)).is_some())
    }

    /// Fewest actions from here to each viewpoint, by [`Viewpoint::index`]: a breadth-first search over
    /// the 15 actions.
    pub fn moves_to_all(self) -> [u32; VIEWPOINTS] {
        let mut moves = [u32::MAX; VIEWPOINTS];
        moves[self.index()] = 0;
        let mut queue = std::collections::VecDeque::from([self]);
        while let Some(here) = queue.pop_front() {
            for next in (0..ACTION_COUNT).filter_map(Action::from_index).filter_map(|a| here.after(a)) {
                if moves[next.index()] == u32::MAX {
                    moves[next.index()] = moves[here.index()] + 1;
                    queue.push_back(next);
                }
            }
        }
        moves
    }

    /// The four viewpoints whose pictures start the map when the episode begins here.
    pub fn seeds(self) -> [Self; 4] {
        SEED_OFFSETS.map(|d| Self { node: (self.node as i32 + d).rem_euclid(NODES as i32) as u32, pitch: SEED_PITCH })
    }
}

/// The camera's intrinsics: 640×480, 60° horizontally.
pub fn intrinsics() -> Pinhole {
    let f = f64::from(WIDTH) / (2.0 * (FOV_DEG.to_radians() / 2.0).tan());
    Pinhole { width: WIDTH, height: HEIGHT, fx: f, fy: f, cx: f64::from(WIDTH) / 2.0, cy: f64::from(HEIGHT) / 2.0 }
}

/// The cameras of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Ring {
    ellipse: Ellipse,
    table_height: f64,
}

impl Ring {
    /// The ring of a scene.
    pub fn of(scene: &SceneConfiguration) -> Self {
        Self { ellipse: scene.ellipse.clone(), table_height: f64::from(scene.table.height_m) }
    }

    /// Middle of the ellipse at the height of the table top, metres.
    pub fn center(&self) -> Point3<f64> {
        Point3::new(self.ellipse.center_m[0], self.ellipse.center_m[1], self.table_height)
    }

    /// Camera of a viewpoint.
    pub fn camera(&self, viewpoint: Viewpoint) -> Camera {
        let angle = TAU * f64::from(viewpoint.node) / f64::from(NODES);
        let e = &self.ellipse;
        let (dx, dy) = (e.semi_axes_m[0] * angle.cos(), e.semi_axes_m[1] * angle.sin());
        let eye = Point3::new(e.center_m[0] + dx, e.center_m[1] + dy, e.camera_height_m);
        let pitch = PITCHES_DEG[viewpoint.pitch as usize].to_radians();
        Camera { intrinsics: intrinsics(), pose: Pose::from_yaw_pitch(eye, (-dy).atan2(-dx), pitch) }
    }

    /// The fixed camera that looks straight down on the middle (supplement, canonical view): as
    /// high as the ring's cameras would be far away, 1 m above the table.
    pub fn canonical(&self) -> Camera {
        let target = self.center();
        let eye = Point3::new(target.x, target.y, target.z + 1.0);
        Camera { intrinsics: intrinsics(), pose: Pose::look_at(eye, target) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring() -> Ring {
        Ring {
            ellipse: Ellipse { center_m: [0.2, -0.1], semi_axes_m: [0.8, 0.6], camera_height_m: 1.5 },
            table_height: 0.75,
        }
    }

    #[test]
    fn every_camera_faces_the_centre_at_its_pitch() {
        let ring = ring();
        assert_eq!(Viewpoint::all().count(), 108);
        for (i, v) in Viewpoint::all().enumerate() {
            assert_eq!(v.index(), i);
            let camera = ring.camera(v);
            let center = Point3::new(0.2, -0.1, 1.5);
            let (u, _, z) = camera.project(&center).unwrap();
            assert!((u - 320.0).abs() < 1e-9, "centre off the vertical midline at {v:?}");
            // The centre at eye height is seen above the optical axis by exactly the pitch.
            let radius = camera.pose.center().coords.metric_distance(&center.coords);
            assert!((z - radius * PITCHES_DEG[v.pitch as usize].to_radians().cos()).abs() < 1e-9);
        }
    }

    /// The camera's right as the picture has it: after `Δp > 0` the camera is where the old picture
    /// showed it to the right of the middle.
    #[test]
    fn positive_moves_go_to_the_right_and_down() {
        let ring = ring();
        for node in 0..36 {
            let here = Viewpoint::new(node, 1).unwrap();
            let pose = ring.camera(here).pose;
            let right = here.after(Action { ring: 1, pitch: 0 }).unwrap();
            assert!(pose.to_camera(&ring.camera(right).pose.center()).x > 0.0);
            // Something nearer than the table's middle, seen at the right edge, comes to the middle.
            let there = ring.camera(here).unproject(560.0, 300.0, 0.4);
            let off = |v: Viewpoint| (ring.camera(v).project(&there).unwrap().0 - 320.0).abs();
            assert!(off(right) < off(here), "node {node}");
            let down = here.after(Action { ring: 0, pitch: 1 }).unwrap();
            let low = ring.camera(here).unproject(320.0, 460.0, 1.0);
            assert!(ring.camera(down).project(&low).unwrap().1 < 460.0);
        }
    }

    #[test]
    fn nodes_wrap_and_pitches_do_not() {
        let v = Viewpoint::new(35, 2).unwrap();
        assert_eq!(v.apply(Action { ring: 2, pitch: -1 }.index()).unwrap(), Viewpoint::new(1, 1).unwrap());
        assert_eq!(v.apply(14).unwrap_err(), RingError::Masked { action: 14, pitch: 2 });
        assert_eq!(v.apply(15).unwrap_err(), RingError::Action(15));
        assert_eq!(v.action_mask().iter().filter(|m| **m).count(), 10);
        assert_eq!(Viewpoint::new(0, 1).unwrap().action_mask(), [true; 15]);
        assert_eq!(Viewpoint::new(1, 0).unwrap().seeds().map(Viewpoint::node), [35, 0, 2, 3]);
        assert!(Viewpoint::new(36, 0).is_err() && Viewpoint::new(0, 3).is_err());
    }

    /// Two nodes and one pitch a move: the longer of the two ways decides.
    #[test]
    fn the_fewest_moves_are_those_of_the_longer_way() {
        let here = Viewpoint::new(1, 0).unwrap();
        let moves = here.moves_to_all();
        for v in Viewpoint::all() {
            let apart = v.node().abs_diff(1).min(36 - v.node().abs_diff(1));
            assert_eq!(moves[v.index()], apart.div_ceil(2).max(v.pitch()), "{v:?}");
        }
    }

    #[test]
    fn canonical_view_has_the_middle_in_the_middle() {
        let (u, v, z) = ring().canonical().project(&ring().center()).unwrap();
        assert!((u - 320.0).abs() < 1e-9 && (v - 240.0).abs() < 1e-9 && (z - 1.0).abs() < 1e-9);
    }
}
