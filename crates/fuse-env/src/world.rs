//! A laid table that can be looked at: what an episode describes, ready to render.

mod view;

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use fuse_render::{Instance, Light, Model, RenderOptions, Renderer, Scene, SceneError, SensorError, SoftBox};
use glam::{Affine3A, Vec3};
use nalgebra::Point3;

use crate::catalogue::{Catalogue, CatalogueError};
use crate::configuration::{self, ConfigurationError, Lighting, SceneConfiguration};
use crate::episode::{Episode, EpisodeError, EpisodeObject};
use crate::placement::solid::Solid;
use crate::ring::Ring;
use crate::room;
use crate::targets::{self, Subject, TargetStatistics};
pub use view::World;

/// Linear radiance behind everything (through the missing ceiling).
const BACKGROUND: Vec3 = Vec3::new(0.62, 0.63, 0.65);

/// Why a world could not be made.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// The objects.
    #[error(transparent)]
    Catalogue(#[from] CatalogueError),
    /// The scenes.
    #[error(transparent)]
    Configuration(#[from] ConfigurationError),
    /// The episode.
    #[error(transparent)]
    Episode(#[from] EpisodeError),
    /// The renderer.
    #[error("cannot render scene `{scene}`: {source}")]
    Scene {
        /// Scene name.
        scene: String,
        /// What the renderer said.
        source: SceneError,
    },
    /// The sensor.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// An instance that is not there.
    #[error("no instance {id} on the table of this episode; there are {}", listed(known))]
    Instance {
        /// Asked for.
        id: u32,
        /// What there is.
        known: Vec<u32>,
    },
    /// The GPU that renders.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] fuse_camera::gpu::GpuError),
}

fn listed(ids: &[u32]) -> String {
    ids.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")
}

type Solids = Mutex<HashMap<String, Arc<Solid>>>;
type Cache = Mutex<HashMap<String, Arc<[Arc<Model>]>>>;

/// Objects and scenes, each loaded or painted once and shared by all worlds.
#[derive(Debug)]
pub struct Stage {
    catalogue: Catalogue,
    scenes: Vec<SceneConfiguration>,
    models: Cache,
    rooms: Cache,
    solids: Solids,
}

impl Stage {
    /// From the folder of objects and the scenes file.
    pub fn load(objects: &Path, scenes: &Path) -> Result<Self, WorldError> {
        Self::load_with(&[objects], scenes)
    }

    /// From several folders of objects, such as the shipped one and a user's, and the scenes file.
    pub fn load_with(objects: &[impl AsRef<Path>], scenes: &Path) -> Result<Self, WorldError> {
        Ok(Self::new(Catalogue::load_all(objects)?, configuration::load(scenes)?))
    }

    /// From what is loaded already.
    pub fn new(catalogue: Catalogue, scenes: Vec<SceneConfiguration>) -> Self {
        Self { catalogue, scenes, models: Cache::default(), rooms: Cache::default(), solids: Solids::default() }
    }

    /// The objects.
    pub fn catalogue(&self) -> &Catalogue {
        &self.catalogue
    }

    /// The scenes.
    pub fn scenes(&self) -> &[SceneConfiguration] {
        &self.scenes
    }

    /// The scene called `name`.
    pub fn scene(&self, name: &str) -> Result<&SceneConfiguration, ConfigurationError> {
        configuration::find(&self.scenes, name)
    }

    /// The model of an object of the catalogue.
    pub fn model(&self, id: &str) -> Result<Arc<Model>, WorldError> {
        let models = cached(&self.models, id, || {
            let record = self.catalogue.get(id).ok_or_else(|| EpisodeError::Invalid {
                episode: "being loaded".into(),
                reason: format!("unknown object `{id}`"),
            })?;
            Ok::<_, WorldError>(vec![self.catalogue.model(record)?])
        })?;
        Ok(models[0].clone())
    }

    /// The rigid body of an object of the catalogue; made when it is first asked for (about 0.1 s).
    pub fn solid(&self, id: &str) -> Result<Arc<Solid>, WorldError> {
        if let Some(found) = self.solids.lock().unwrap_or_else(PoisonError::into_inner).get(id) {
            return Ok(found.clone());
        }
        let solid = Solid::new(self.model(id)?.as_ref())
            .ok_or_else(|| EpisodeError::Invalid {
                episode: "being laid out".into(),
                reason: format!("object `{id}` spans no volume, so it cannot be put down"),
            })
            .map(Arc::new)?;
        Ok(self.solids.lock().unwrap_or_else(PoisonError::into_inner).entry(id.to_owned()).or_insert(solid).clone())
    }

    /// The models of a room. `painted` false leaves all surfaces at a few texels: for counting
    /// pixels, where colour does not matter.
    fn room(&self, scene: &SceneConfiguration, painted: bool) -> Result<Arc<[Arc<Model>]>, WorldError> {
        cached(&self.rooms, &format!("{} {painted}", scene.name), || {
            let mut scene = scene.clone();
            if !painted {
                let (r, t) = (&mut scene.room, &mut scene.table);
                for s in [&mut r.floor, &mut r.wall, &mut r.wood, &mut t.top, &mut t.frame] {
                    s.texels = 64;
                }
            }
            Ok(room::build(&scene))
        })
    }

    /// A renderer of a scene with `objects` on its table; `painted` false is for counting pixels.
    pub fn renderer(
        &self,
        scene: &SceneConfiguration,
        objects: &[EpisodeObject],
        painted: bool,
    ) -> Result<Renderer, WorldError> {
        let (scene_3d, options) = self.laid(scene, objects, painted)?;
        Renderer::new(scene_3d, &options).map_err(|source| WorldError::Scene { scene: scene.name.clone(), source })
    }

    /// What a renderer of a scene with `objects` on its table is made from.
    fn laid(
        &self,
        scene: &SceneConfiguration,
        objects: &[EpisodeObject],
        painted: bool,
    ) -> Result<(Scene, RenderOptions), WorldError> {
        let room = self.room(scene, painted)?;
        let mut instances: Vec<Instance> =
            room.iter().map(|m| Instance { model: m.clone(), transform: Affine3A::IDENTITY, id: 0 }).collect();
        for object in objects {
            let model = self.model(&object.model_id)?;
            instances.push(Instance { model, transform: object.transform(), id: object.instance_id });
        }
        let scene_3d = Scene { instances, light: light(&scene.light), background: BACKGROUND };
        Ok((scene_3d, if painted { RenderOptions::default() } else { unlit() }))
    }

    /// Objects whose views are to be counted: each alone, without the room.
    pub fn subjects(&self, scene: &SceneConfiguration, objects: &[&EpisodeObject]) -> Result<Vec<Subject>, WorldError> {
        objects
            .iter()
            .map(|object| {
                let instance = Instance {
                    model: self.model(&object.model_id)?,
                    transform: object.transform(),
                    id: object.instance_id,
                };
                let alone = truth(vec![instance], &scene.name)?;
                Ok(Subject { id: object.instance_id, middle: self.middle(object)?, alone })
            })
            .collect()
    }

    /// What the viewpoints see of an episode's valid targets, counted anew.
    pub fn statistics(&self, episode: &Episode) -> Result<Vec<TargetStatistics>, WorldError> {
        let scene = self.scene(&episode.scene_id)?;
        let whole = self.renderer(scene, &episode.objects, false)?;
        let targets: Vec<&EpisodeObject> =
            episode.valid_target_ids.iter().filter_map(|id| episode.object(*id)).collect();
        Ok(targets::statistics(&whole, &Ring::of(scene), &self.subjects(scene, &targets)?))
    }

    /// Middle of an object's bounding box in the world, metres.
    fn middle(&self, object: &EpisodeObject) -> Result<Point3<f64>, WorldError> {
        let (model, transform) = (self.model(&object.model_id)?, object.transform());
        let points = model.meshes.iter().flat_map(|m| &m.positions).map(|p| transform.transform_point3(*p));
        let (low, high) = points.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
        let m = (low + high).as_dvec3() / 2.0;
        Ok(Point3::new(m.x, m.y, m.z))
    }
}

fn cached<E>(cache: &Cache, key: &str, make: impl FnOnce() -> Result<Vec<Model>, E>) -> Result<Arc<[Arc<Model>]>, E> {
    // A poisoned lock still holds whole entries: they are inserted in one step.
    if let Some(found) = cache.lock().unwrap_or_else(PoisonError::into_inner).get(key) {
        return Ok(found.clone());
    }
    // Made outside the lock, because painting uses the thread pool that may be waiting for it.
    let made: Arc<[Arc<Model>]> = make()?.into_iter().map(Arc::new).collect();
    Ok(cache.lock().unwrap_or_else(PoisonError::into_inner).entry(key.to_owned()).or_insert(made).clone())
}

/// The renderer's light of a scene's.
pub fn light(lighting: &Lighting) -> Light {
    Light {
        position: Vec3::from_array(lighting.position_m),
        radius: lighting.radius_m,
        intensity: Vec3::from_array(lighting.intensity),
        sky: Vec3::from_array(lighting.sky),
        ground: Vec3::from_array(lighting.ground),
        soft_boxes: lighting
            .glows
            .iter()
            .map(|g| SoftBox {
                direction: Vec3::from_array(g.direction),
                color: Vec3::from_array(g.color),
                sharpness: g.sharpness,
            })
            .collect(),
        exposure: lighting.exposure,
    }
}

fn unlit() -> RenderOptions {
    RenderOptions { shadows: false, ambient_occlusion: false, ..RenderOptions::default() }
}

/// A renderer whose colours are of no interest.
fn truth(instances: Vec<Instance>, scene: &str) -> Result<Renderer, WorldError> {
    let scene_3d = Scene { instances, ..Scene::default() };
    Renderer::new(scene_3d, &unlit()).map_err(|source| WorldError::Scene { scene: scene.to_owned(), source })
}
