//! An episode's world: pictures, through a sensor if there is one, and exact truths about them.

#[cfg(feature = "gpu")]
use std::sync::OnceLock;

use fuse_camera::{Buffer, Camera, DepthBuffer, IdBuffer};
use fuse_render::{Frame, Instance, RenderOptions, Renderer, Scene, Sensor};
use sha2::{Digest, Sha256};

use super::{Stage, WorldError, truth};
use crate::episode::Episode;
use crate::ring::{Ring, Viewpoint};

/// An episode's scene, ready to be seen from any camera.
pub struct World {
    renderer: Prepared,
    ring: Ring,
    sensor: Sensor,
    name: Name,
    /// What stands where, for truths that only the CPU tells.
    instances: Vec<Instance>,
}

/// What tells an episode from others.
struct Name {
    episode_id: String,
    seed: u64,
    scene: String,
}

/// A scene on the backend that it was prepared for.
enum Prepared {
    Cpu(Box<Renderer>),
    /// And the CPU's, made when it is first asked for.
    #[cfg(feature = "gpu")]
    Gpu(Box<fuse_render::gpu::GpuRenderer>, OnceLock<Box<Renderer>>),
}

impl World {
    /// Checks the episode and prepares its scene on the CPU.
    pub fn load(episode: &Episode, stage: &Stage) -> Result<Self, WorldError> {
        Self::prepare(episode, stage, |scene_3d, options, scene| {
            let renderer = Renderer::new(scene_3d, options);
            let renderer = renderer.map_err(|source| WorldError::Scene { scene: scene.to_owned(), source })?;
            Ok(Prepared::Cpu(Box::new(renderer)))
        })
    }

    /// Checks the episode and prepares its scene on what `choice` names.
    #[cfg(feature = "gpu")]
    pub fn load_on(episode: &Episode, stage: &Stage, choice: &fuse_render::gpu::Choice) -> Result<Self, WorldError> {
        use fuse_render::gpu::{Choice, GpuRenderer, RenderError};
        let Choice::Gpu(device) = choice else { return Self::load(episode, stage) };
        Self::prepare(episode, stage, |scene_3d, options, scene| {
            let renderer = GpuRenderer::new(scene_3d, options, device).map_err(|error| match error {
                RenderError::Scene(source) => WorldError::Scene { scene: scene.to_owned(), source },
                RenderError::Gpu(error) => error.into(),
            })?;
            Ok(Prepared::Gpu(Box::new(renderer), OnceLock::new()))
        })
    }

    fn prepare(
        episode: &Episode,
        stage: &Stage,
        make: impl FnOnce(Scene, &RenderOptions, &str) -> Result<Prepared, WorldError>,
    ) -> Result<Self, WorldError> {
        episode.validate(stage.catalogue(), stage.scenes())?;
        let scene = stage.scene(&episode.scene_id)?;
        let (scene_3d, options) = stage.laid(scene, &episode.objects, true)?;
        let instances = scene_3d.instances.clone();
        let renderer = make(scene_3d, &options, &scene.name)?;
        let name = Name { episode_id: episode.episode_id.clone(), seed: episode.seed, scene: scene.name.clone() };
        Ok(Self { renderer, ring: Ring::of(scene), sensor: Sensor::default(), name, instances })
    }

    /// The same world seen through a sensor.
    ///
    /// # Errors
    /// [`WorldError::Sensor`] for settings out of range.
    pub fn with_sensor(self, sensor: Sensor) -> Result<Self, WorldError> {
        sensor.check()?;
        Ok(Self { sensor, ..self })
    }

    /// The scene's viewpoints.
    pub fn ring(&self) -> &Ring {
        &self.ring
    }

    /// The picture from a viewpoint.
    ///
    /// # Errors
    /// If the world is on a GPU and that fails.
    pub fn render(&self, viewpoint: Viewpoint) -> Result<Frame, WorldError> {
        self.render_camera(&self.ring.camera(viewpoint))
    }

    /// The picture from any camera. Its colours and depth are the sensor's, its ids are exact.
    ///
    /// # Errors
    /// As [`World::render`].
    pub fn render_camera(&self, camera: &Camera) -> Result<Frame, WorldError> {
        let mut frame = match &self.renderer {
            Prepared::Cpu(renderer) => renderer.render(camera),
            #[cfg(feature = "gpu")]
            Prepared::Gpu(renderer, _) => renderer.render(camera)?,
        };
        self.sensor.expose(&mut frame, self.noise_of(camera));
        Ok(frame)
    }

    /// Exact depth in metres and ids without a picture, several times as fast; the sensor changes neither.
    ///
    /// # Errors
    /// [`WorldError::Gpu`] if the GPU fails.
    pub fn depth_ids(&self, camera: &Camera) -> Result<(DepthBuffer, IdBuffer), WorldError> {
        match &self.renderer {
            Prepared::Cpu(renderer) => Ok(renderer.depth_ids(camera)),
            #[cfg(feature = "gpu")]
            Prepared::Gpu(renderer, _) => Ok(renderer.depth_ids(camera)?),
        }
    }

    /// Exact normals, see [`Renderer::normals`]; the CPU makes them for either device.
    ///
    /// # Errors
    /// [`WorldError::Scene`], which a world that was loaded has not.
    pub fn normals(&self, camera: &Camera) -> Result<Buffer<[f32; 3]>, WorldError> {
        match &self.renderer {
            Prepared::Cpu(renderer) => Ok(renderer.normals(camera)),
            #[cfg(feature = "gpu")]
            Prepared::Gpu(_, exact) => {
                if let Some(renderer) = exact.get() {
                    return Ok(renderer.normals(camera));
                }
                let made = Box::new(truth(self.instances.clone(), &self.name.scene)?);
                Ok(exact.get_or_init(|| made).normals(camera))
            }
        }
    }

    /// Which pixel centres an instance would cover if it stood alone. The CPU draws it for either device, as it counts
    /// the statistics of an episode.
    ///
    /// # Errors
    /// [`WorldError::Instance`] for an id that no object has; 0, the room, is none.
    pub fn amodal_mask(&self, id: u32, camera: &Camera) -> Result<Buffer<bool>, WorldError> {
        let alone: Vec<Instance> = self.instances.iter().filter(|i| i.id == id && id != 0).cloned().collect();
        if alone.is_empty() {
            let known = self.instances.iter().map(|i| i.id).filter(|id| *id != 0).collect();
            return Err(WorldError::Instance { id, known });
        }
        let (_, ids) = truth(alone, &self.name.scene)?.depth_ids(camera);
        let covered = ids.as_slice().iter().map(|found| *found == id);
        let mut mask = Buffer::filled(ids.width(), ids.height(), false);
        mask.as_mut_slice().iter_mut().zip(covered).for_each(|(to, from)| *to = from);
        Ok(mask)
    }

    /// Names a view's noise: the same sensor seed, episode and place give the same. The place is the viewpoint, of
    /// a camera off the ring its numbers.
    fn noise_of(&self, camera: &Camera) -> u64 {
        let mut hash = Sha256::new();
        hash.update(self.sensor.seed.to_le_bytes());
        hash.update(self.name.seed.to_le_bytes());
        match Viewpoint::all().find(|v| self.ring.camera(*v) == *camera) {
            Some(viewpoint) => hash.update((viewpoint.index() as u64).to_le_bytes()),
            None => {
                let (k, p) = (&camera.intrinsics, &camera.pose);
                hash.update(u64::MAX.to_le_bytes());
                hash.update(k.width.to_le_bytes());
                hash.update(k.height.to_le_bytes());
                for number in [k.fx, k.fy, k.cx, k.cy].iter().chain(&p.rotation.coords).chain(&p.translation) {
                    hash.update(number.to_le_bytes());
                }
            }
        }
        hash.update(self.name.episode_id.as_bytes());
        hash.finalize().iter().take(8).fold(0, |key, byte| key << 8 | u64::from(*byte))
    }
}
