//! Scenes, viewpoints, episodes, worlds.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use fuse_env::catalogue::{Category, Split};
use fuse_env::episode::{self, Episode};
use fuse_env::generate::{self, Request, Validity};
use fuse_env::ring::Viewpoint;
use fuse_env::world;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;

use crate::array::{into_2d, into_3d};
use crate::camera::Camera;
use crate::enter::enter;
use crate::error::input;
use crate::render::take;

type Picture<'py> = (Bound<'py, PyArray3<u8>>, Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<u32>>);
/// Episodes as JSON with the reasons and counts of the layouts thrown away before each.
type Made = Vec<(String, BTreeMap<&'static str, u32>)>;

fn viewpoint(node: u32, pitch_index: u32) -> PyResult<Viewpoint> {
    Viewpoint::new(node, pitch_index).map_err(|e| input(e.to_string()))
}

fn categories(table: BTreeMap<String, Vec<String>>) -> PyResult<Validity> {
    let parse = |names: Vec<String>| names.iter().map(|n| n.parse::<Category>()).collect::<Result<Vec<_>, _>>();
    let rows = table.into_iter().map(|(verb, names)| Ok((verb, parse(names)?)));
    rows.collect::<Result<_, fuse_env::catalogue::CatalogueError>>().map_err(|e| input(e.to_string()))
}

fn to_json(episode: &Episode) -> PyResult<String> {
    serde_json::to_string(episode).map_err(|e| input(format!("episode `{}`: {e}", episode.episode_id)))
}

fn told(made: Vec<(Episode, generate::Rejections)>) -> PyResult<Made> {
    made.into_iter().map(|(e, rejections)| Ok((to_json(&e)?, rejections))).collect()
}

/// Objects and scenes, each loaded or painted once and shared by all worlds.
///
/// Stage(objects_directory, scenes_path)
///
/// Raises InputError that names the file when something is missing or not what it should be.
#[pyclass(frozen, module = "fuse_grounding")]
pub struct Stage {
    inner: Arc<world::Stage>,
}

#[pymethods]
impl Stage {
    #[new]
    fn new(py: Python<'_>, objects_directory: PathBuf, scenes_path: PathBuf) -> PyResult<Self> {
        let inner = enter(py, || world::Stage::load(&objects_directory, &scenes_path))?;
        Ok(Self { inner: Arc::new(inner) })
    }

    /// Names of the scenes, with split, whether the table is weakly textured, and a description.
    fn scenes(&self) -> Vec<(String, &'static str, bool, String)> {
        let rows = self.inner.scenes().iter();
        rows.map(|s| (s.name.clone(), s.split.id(), s.weak_texture, s.description.clone())).collect()
    }

    /// Makes the episode of a verb in a scene; the same arguments give the same episode. `validity`
    /// lists the valid categories of each verb. Returns JSON and, by reason, how many layouts were
    /// thrown away before it.
    #[pyo3(signature = (validity, scene, verb, query, seed, episode_id))]
    #[allow(clippy::too_many_arguments)]
    fn make_episode(
        &self,
        py: Python<'_>,
        validity: BTreeMap<String, Vec<String>>,
        scene: String,
        verb: String,
        query: String,
        seed: u64,
        episode_id: String,
    ) -> PyResult<(String, BTreeMap<&'static str, u32>)> {
        let validity = categories(validity)?;
        let request = Request { scene, verb, query, seed, episode_id };
        let (episode, rejections) = enter(py, || generate::episode(&self.inner, &validity, &request))?;
        Ok((to_json(&episode)?, rejections))
    }

    /// Makes a set of `count` episodes over the scenes of a split. `queries` lists for each verb the
    /// words that it is asked with. Returns what `make_episode` returns, for each.
    fn make_episodes(
        &self,
        py: Python<'_>,
        validity: BTreeMap<String, Vec<String>>,
        queries: BTreeMap<String, Vec<String>>,
        split: &str,
        count: usize,
        seed: u64,
    ) -> PyResult<Made> {
        let split: Split = split.parse().map_err(|e: fuse_env::catalogue::CatalogueError| input(e.to_string()))?;
        let validity = categories(validity)?;
        let requests = generate::requests(self.inner.scenes(), split, &queries, count, seed);
        if requests.len() < count {
            return Err(input(format!(
                "no episodes can be made for split {split}: it has no scene, or no verb is given"
            )));
        }
        told(enter(py, || generate::episodes(&self.inner, &validity, &requests))?)
    }

    /// Checks an episode (JSON) against the objects and scenes. Raises InputError.
    fn validate(&self, py: Python<'_>, episode_json: &str) -> PyResult<()> {
        enter(py, || Episode::from_json(episode_json)?.validate(self.inner.catalogue(), self.inner.scenes()))
    }
}

/// An episode's scene, ready to be seen from any camera.
///
/// World(episode_json, stage, device="cpu")
///
/// device: what renders: `cpu`, `gpu`, or `auto` for a real GPU if there is one, else the CPU.
///
/// Raises InputError for an episode that is not sound, and where a GPU is asked for and there is
/// none.
#[pyclass(frozen, module = "fuse_grounding")]
pub struct World {
    inner: world::World,
}

impl World {
    fn picture<'py>(&self, py: Python<'py>, camera: &fuse_camera::Camera) -> PyResult<Picture<'py>> {
        let frame = enter(py, || self.inner.render_camera(camera))?;
        let (w, h) = (frame.rgb.width(), frame.rgb.height());
        let rgb = frame.rgb.into_vec().into_flattened();
        let (depth, ids) = (frame.depth.into_vec(), frame.instance.into_vec());
        Ok((into_3d(py, rgb, w, h, 3)?, into_2d(py, depth, w, h)?, into_2d(py, ids, w, h)?))
    }
}

#[pymethods]
impl World {
    #[new]
    #[pyo3(signature = (episode_json, stage, device="cpu"))]
    fn new(py: Python<'_>, episode_json: &str, stage: &Stage, device: &str) -> PyResult<Self> {
        let stage = &stage.inner;
        let choice = enter(py, || take(device))?;
        let load = || world::World::load_on(&Episode::from_json(episode_json)?, stage, &choice);
        Ok(Self { inner: enter(py, load)? })
    }

    /// (480, 640, 3) uint8 colour, (480, 640) float32 depth in metres, (480, 640) uint32 ids.
    fn render<'py>(&self, py: Python<'py>, node: u32, pitch_index: u32) -> PyResult<Picture<'py>> {
        self.picture(py, &self.inner.ring().camera(viewpoint(node, pitch_index)?))
    }

    /// As `render`, from any camera.
    fn render_camera<'py>(&self, py: Python<'py>, camera: &Camera) -> PyResult<Picture<'py>> {
        self.picture(py, &camera.inner)
    }

    /// Camera of a viewpoint.
    fn camera(&self, node: u32, pitch_index: u32) -> PyResult<Camera> {
        Ok(Camera { inner: self.inner.ring().camera(viewpoint(node, pitch_index)?) })
    }

    /// Camera that looks straight down on the middle of the scene.
    fn canonical_camera(&self) -> Camera {
        Camera { inner: self.inner.ring().canonical() }
    }
}

/// (15,) bool: which actions are possible from a viewpoint.
#[pyfunction]
fn action_mask<'py>(py: Python<'py>, node: u32, pitch_index: u32) -> PyResult<Bound<'py, PyArray1<bool>>> {
    Ok(viewpoint(node, pitch_index)?.action_mask().to_vec().into_pyarray(py))
}

/// The viewpoint (node, pitch index) after an action. Raises InputError for one that is masked.
#[pyfunction]
fn apply_action(node: u32, pitch_index: u32, action: usize) -> PyResult<(u32, u32)> {
    let after = viewpoint(node, pitch_index)?.apply(action).map_err(|e| input(e.to_string()))?;
    Ok((after.node(), after.pitch()))
}

/// The four viewpoints (node, pitch index) whose pictures start the map of an episode that begins at
/// a viewpoint.
#[pyfunction]
fn seed_viewpoints(node: u32, pitch_index: u32) -> PyResult<Vec<(u32, u32)>> {
    Ok(viewpoint(node, pitch_index)?.seeds().iter().map(|v| (v.node(), v.pitch())).collect())
}

/// Episodes of a `.json.gz` file, each as JSON; form and version are checked.
#[pyfunction]
fn read_episodes(py: Python<'_>, path: PathBuf) -> PyResult<Vec<String>> {
    enter(py, || episode::read(&path))?.iter().map(to_json).collect()
}

/// Writes episodes (JSON each) to a `.json.gz` file, whole or not at all.
#[pyfunction]
fn write_episodes(py: Python<'_>, path: PathBuf, episodes: Vec<String>) -> PyResult<()> {
    enter(py, || {
        let parsed = episodes.iter().map(|e| Episode::from_json(e)).collect::<Result<Vec<_>, _>>()?;
        episode::write(&path, &parsed)
    })
}

/// Adds this file's classes and functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Stage>()?;
    module.add_class::<World>()?;
    module.add_function(wrap_pyfunction!(action_mask, module)?)?;
    module.add_function(wrap_pyfunction!(apply_action, module)?)?;
    module.add_function(wrap_pyfunction!(seed_viewpoints, module)?)?;
    module.add_function(wrap_pyfunction!(read_episodes, module)?)?;
    module.add_function(wrap_pyfunction!(write_episodes, module)?)
}
