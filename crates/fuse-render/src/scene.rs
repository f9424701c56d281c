//! What is rendered, and how.

use std::sync::Arc;

use fuse_camera::{DepthBuffer, IdBuffer, RgbBuffer};
use glam::{Affine3A, Vec3};

use crate::{Light, Model};

/// A model placed in the world.
#[derive(Clone, Debug)]
pub struct Instance {
    /// The shape.
    pub model: Arc<Model>,
    /// World from model.
    pub transform: Affine3A,
    /// What the id image shows; 0 is the room and the table. Instances may share an id.
    pub id: u32,
}

/// Everything that is seen.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Things, the room included.
    pub instances: Vec<Instance>,
    /// Light.
    pub light: Light,
    /// Linear radiance where no surface is hit.
    pub background: Vec3,
}

/// What the renderer prepares and computes.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderOptions {
    /// Whether the key light casts shadows.
    pub shadows: bool,
    /// Side of the shadow maps, texels, 64 to 8192.
    pub shadow_resolution: u32,
    /// Whether nearby surfaces darken the ambient light.
    pub ambient_occlusion: bool,
    /// Depth of the near plane, metres.
    pub near: f32,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self { shadows: true, shadow_resolution: 2048, ambient_occlusion: true, near: 0.01 }
    }
}

/// One observation.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Anti-aliased sRGB colour.
    pub rgb: RgbBuffer,
    /// Planar depth at the pixel centres, metres; 0 where nothing was hit.
    pub depth: DepthBuffer,
    /// Instance ids at the pixel centres.
    pub instance: IdBuffer,
}

/// How much of an instance a camera sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Amodal {
    /// Instance id.
    pub id: u32,
    /// Pixels whose centre shows it.
    pub visible_px: u32,
    /// Pixels whose centre would show it if nothing else were there.
    pub unoccluded_px: u32,
}

/// Why a scene cannot be rendered.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// An instance's model is inconsistent.
    #[error("instance {index} (id {id}): {reason}")]
    Model {
        /// Position in `Scene::instances`.
        index: usize,
        /// Its id.
        id: u32,
        /// What was found and what was expected.
        reason: String,
    },
    /// A number outside its range.
    #[error("{name} must be {expected}, found {found}")]
    Value {
        /// Which field.
        name: &'static str,
        /// Allowed values.
        expected: &'static str,
        /// Value found.
        found: String,
    },
    /// More than 2³² vertices, or a similar excess.
    #[error("the scene has {triangles} triangles, at most {limit} are supported")]
    TooLarge {
        /// Found.
        triangles: usize,
        /// Allowed.
        limit: usize,
    },
}
