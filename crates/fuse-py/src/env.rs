//! Scenes, viewpoints, episodes, worlds.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use fuse_env::catalogue::{Category, Split};
use fuse_env::difficulty::Difficulty;
use fuse_env::episode::{self, Episode, EpisodeSet, Witness};
use fuse_env::generate::{self, Request, Validity};
use fuse_env::ring::Viewpoint;
use fuse_env::targets::TargetStatistics;
use fuse_env::world;
use fuse_render::Sensor;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;

use crate::array::{into_2d, into_3d};
use crate::camera::Camera;
use crate::enter::enter;
use crate::error::input;
use crate::render::take;

type Picture<'py> = (Bound<'py, PyArray3<u8>>, Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<u32>>);
type DepthIds<'py> = (Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<u32>>);
/// An episode and its targets' statistics, as JSON, and how many layouts were thrown away before it, by reason.
type Made = (String, String, BTreeMap<&'static str, u32>);
/// Scene, verb, query, seed and id of an episode to be made.
type Asked = (String, String, String, u64, String);

fn viewpoint(node: u32, pitch_index: u32) -> PyResult<Viewpoint> {
    Viewpoint::new(node, pitch_index).map_err(|e| input(e.to_string()))
}

/// A validity table over the shipped categories and those of the stage's libraries.
fn categories(stage: &world::Stage, table: BTreeMap<String, Vec<String>>) -> PyResult<Validity> {
    let parse =
        |names: Vec<String>| names.iter().map(|n| stage.catalogue().category(n)).collect::<Result<Vec<Category>, _>>();
    let rows = table.into_iter().map(|(verb, names)| Ok((verb, parse(names)?)));
    rows.collect::<Result<_, fuse_env::catalogue::CatalogueError>>().map_err(|e| input(e.to_string()))
}

fn to_json(value: &impl serde::Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|e| input(e.to_string()))
}

fn from_json<T: for<'de> serde::Deserialize<'de>>(what: &str, text: &str) -> PyResult<T> {
    serde_json::from_str(text).map_err(|e| input(format!("{what}: {e}")))
}

fn told(made: generate::Made) -> PyResult<Made> {
    Ok((to_json(&made.episode)?, to_json(&made.statistics)?, made.rejections))
}

fn request((scene, verb, query, seed, episode_id): Asked) -> Request {
    Request { scene, verb, query, seed, episode_id }
}

/// Objects and scenes, each loaded or painted once and shared by all worlds.
///
/// Stage(objects_directory, scenes_path, libraries=())
///
/// `libraries`: further folders of objects, such as `fuse objects import` makes.
///
/// Raises InputError that names the file when something is missing or not what it should be.
#[pyclass(frozen, module = "fuse_grounding")]
pub struct Stage {
    inner: Arc<world::Stage>,
}

#[pymethods]
impl Stage {
    #[new]
    #[pyo3(signature = (objects_directory, scenes_path, libraries=vec![]))]
    fn new(
        py: Python<'_>,
        objects_directory: PathBuf,
        scenes_path: PathBuf,
        libraries: Vec<PathBuf>,
    ) -> PyResult<Self> {
        let folders: Vec<PathBuf> = std::iter::once(objects_directory).chain(libraries).collect();
        let inner = enter(py, || world::Stage::load_with(&folders, &scenes_path))?;
        Ok(Self { inner: Arc::new(inner) })
    }

    /// What the libraries state: verb -> categories valid for it, to be put into a validity table.
    fn stated(&self) -> BTreeMap<String, Vec<&'static str>> {
        let mut table: BTreeMap<String, Vec<&'static str>> = BTreeMap::new();
        for entry in self.inner.catalogue().categories() {
            for verb in entry.valid_for.keys() {
                let row = table.entry(verb.clone()).or_default();
                if !row.contains(&entry.id.id()) {
                    row.push(entry.id.id());
                }
            }
        }
        table
    }

    /// Names of the scenes, with split, whether the table is weakly textured, and a description.
    fn scenes(&self) -> Vec<(String, &'static str, bool, String)> {
        let rows = self.inner.scenes().iter();
        rows.map(|s| (s.name.clone(), s.split.id(), s.weak_texture, s.description.clone())).collect()
    }

    /// What a set of `count` episodes asks for: scene, verb, query, seed and id of each. `queries` lists for each verb
    /// the words that it is asked with; scenes and verbs come evenly.
    fn plan_episodes(
        &self,
        set: &str,
        split: &str,
        queries: BTreeMap<String, Vec<String>>,
        count: usize,
        seed: u64,
    ) -> PyResult<Vec<Asked>> {
        let split: Split = split.parse().map_err(|e: fuse_env::catalogue::CatalogueError| input(e.to_string()))?;
        let requests = generate::requests(self.inner.scenes(), set, split, &queries, count, seed);
        if requests.len() < count {
            return Err(input(format!(
                "no episodes can be made for split {split}: it has no scene, or no verb is given"
            )));
        }
        Ok(requests.into_iter().map(|r| (r.scene, r.verb, r.query, r.seed, r.episode_id)).collect())
    }

    /// Makes the episode of a request, without another seed; the same arguments give the same episode. `validity` lists
    /// the valid categories of each verb; `difficulty` is JSON, see `default_difficulty`. Returns the episode and its
    /// targets' statistics, both JSON, and by reason how many layouts were thrown away before it.
    fn make_episode(
        &self,
        py: Python<'_>,
        validity: BTreeMap<String, Vec<String>>,
        asked: Asked,
        difficulty: &str,
    ) -> PyResult<Made> {
        let (validity, asked) = (categories(&self.inner, validity)?, request(asked));
        let difficulty: Difficulty = from_json("difficulty", difficulty)?;
        told(enter(py, || generate::episode(&self.inner, &validity, &asked, &difficulty))?)
    }

    /// As `make_episode`, for several, in their order, on `threads` threads (default: all); where a seed has no
    /// episode, the next is drawn from it. The result does not depend on threads.
    #[pyo3(signature = (validity, asked, difficulty, threads=None))]
    fn make_episodes(
        &self,
        py: Python<'_>,
        validity: BTreeMap<String, Vec<String>>,
        asked: Vec<Asked>,
        difficulty: &str,
        threads: Option<usize>,
    ) -> PyResult<Vec<Made>> {
        let validity = categories(&self.inner, validity)?;
        let requests: Vec<Request> = asked.into_iter().map(request).collect();
        let difficulty: Difficulty = from_json("difficulty", difficulty)?;
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).build();
        let pool = pool.map_err(|e| input(format!("cannot start {threads:?} threads: {e}")))?;
        let make = || pool.install(|| generate::episodes(&self.inner, &validity, &requests, &difficulty));
        enter(py, make)?.into_iter().map(told).collect()
    }

    /// Checks an episode (JSON) against the objects and scenes, and against its targets' statistics (JSON) where they
    /// are given. Raises InputError.
    #[pyo3(signature = (episode_json, statistics_json=None))]
    fn validate(&self, py: Python<'_>, episode_json: &str, statistics_json: Option<&str>) -> PyResult<()> {
        let statistics: Option<Vec<TargetStatistics>> =
            statistics_json.map(|text| from_json("statistics", text)).transpose()?;
        enter(py, || {
            let episode = Episode::from_json(episode_json)?;
            episode.validate(self.inner.catalogue(), self.inner.scenes())?;
            statistics.map_or(Ok(()), |s| episode.check_statistics(&s))
        })
    }

    /// What the 108 viewpoints see of an episode's valid targets, counted by rendering: JSON, in their order.
    fn statistics(&self, py: Python<'_>, episode_json: &str) -> PyResult<String> {
        let counted = enter(py, || {
            let episode = Episode::from_json(episode_json)?;
            episode.validate(self.inner.catalogue(), self.inner.scenes())?;
            self.inner.statistics(&episode)
        })?;
        to_json(&counted)
    }
}

/// An episode's scene, ready to be seen from any camera.
///
/// World(episode_json, stage, device="cpu", sensor="{}")
///
/// device: what renders: `cpu`, `gpu`, or `auto` for a real GPU if there is one, else the CPU;
/// sensor: settings of the sensor, JSON; what is not given is off.
///
/// Raises InputError for an episode that is not sound, a sensor's setting that is unknown or out of
/// range, and where a GPU is asked for and there is none.
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
    #[pyo3(signature = (episode_json, stage, device="cpu", sensor="{}"))]
    fn new(py: Python<'_>, episode_json: &str, stage: &Stage, device: &str, sensor: &str) -> PyResult<Self> {
        let stage = &stage.inner;
        let sensor: Sensor = from_json("sensor", sensor)?;
        let choice = enter(py, || take(device))?;
        let load = || world::World::load_on(&Episode::from_json(episode_json)?, stage, &choice)?.with_sensor(sensor);
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

    /// (480, 640) float32 depth in metres and (480, 640) uint32 ids from any camera, without a picture: several times as
    /// fast. Exact, whatever the sensor.
    fn depth_ids<'py>(&self, py: Python<'py>, camera: &Camera) -> PyResult<DepthIds<'py>> {
        let (depth, ids) = enter(py, || self.inner.depth_ids(&camera.inner))?;
        let (w, h) = (depth.width(), depth.height());
        Ok((into_2d(py, depth.into_vec(), w, h)?, into_2d(py, ids.into_vec(), w, h)?))
    }

    /// (480, 640, 3) float32: unit normals in the camera's frame, facing the camera, of the triangles at the pixel
    /// centres; zeros where nothing was hit. Exact, whatever the sensor.
    fn normals<'py>(&self, py: Python<'py>, node: u32, pitch_index: u32) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let camera = self.inner.ring().camera(viewpoint(node, pitch_index)?);
        let normals = enter(py, || self.inner.normals(&camera))?;
        let (w, h) = (normals.width(), normals.height());
        into_3d(py, normals.into_vec().into_flattened(), w, h, 3)
    }

    /// (480, 640) bool: the pixels that an instance would cover if it stood alone. Raises InputError for one that is
    /// not on the table.
    fn amodal_mask<'py>(
        &self,
        py: Python<'py>,
        instance: u32,
        node: u32,
        pitch_index: u32,
    ) -> PyResult<Bound<'py, PyArray2<bool>>> {
        let camera = self.inner.ring().camera(viewpoint(node, pitch_index)?);
        let mask = enter(py, || self.inner.amodal_mask(instance, &camera))?;
        let (w, h) = (mask.width(), mask.height());
        into_2d(py, mask.into_vec(), w, h)
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

/// The knobs of difficulty with their defaults, JSON.
#[pyfunction]
fn default_difficulty() -> PyResult<String> {
    to_json(&Difficulty::default())
}

/// Groups of categories that look or are handled alike: those of a group are near misses of each other.
#[pyfunction]
fn kin_categories() -> Vec<Vec<&'static str>> {
    generate::KIN.iter().map(|group| group.iter().map(|c| c.id()).collect()).collect()
}

/// Fewest actions from a viewpoint to each of the 108, by `3 node + pitch index`.
#[pyfunction]
fn moves_to_all(node: u32, pitch_index: u32) -> PyResult<Vec<u32>> {
    Ok(viewpoint(node, pitch_index)?.moves_to_all().to_vec())
}

/// Episodes of a `.json.gz` file, each as JSON, and how the set was generated (JSON; `null` where it was not); form and
/// version are checked.
#[pyfunction]
fn read_episodes(py: Python<'_>, path: PathBuf) -> PyResult<(Vec<String>, String)> {
    let set = enter(py, || episode::read(&path))?;
    let texts = set.episodes.iter().map(to_json).collect::<PyResult<_>>()?;
    Ok((texts, to_json(&set.generation)?))
}

/// Writes episodes (JSON each) to a `.json.gz` file, whole or not at all. `generation` as `read_episodes` returns it.
#[pyfunction]
#[pyo3(signature = (path, episodes, generation="null"))]
fn write_episodes(py: Python<'_>, path: PathBuf, episodes: Vec<String>, generation: &str) -> PyResult<()> {
    let generation = from_json("generation", generation)?;
    enter(py, || {
        let episodes = episodes.iter().map(|e| Episode::from_json(e)).collect::<Result<Vec<_>, _>>()?;
        let set = EpisodeSet { schema_version: episode::EPISODE_SCHEMA_VERSION, generation, episodes };
        episode::write(&path, &set)
    })
}

/// Where the statistics of an episode file lie: beside it.
#[pyfunction]
fn statistics_path(episodes: PathBuf) -> PathBuf {
    episode::statistics_path(&episodes)
}

/// Statistics (JSON) of each episode of a file, in its order. Raises InputError for those of another file.
#[pyfunction]
fn read_statistics(py: Python<'_>, path: PathBuf, episodes: PathBuf) -> PyResult<Vec<String>> {
    let read = enter(py, || episode::read_statistics(&path, &episodes))?;
    read.iter().map(|w| to_json(&w.targets)).collect()
}

/// Writes the statistics of an episode file that is already there, whole or not at all: id and statistics (JSON) of
/// each episode, in the file's order.
#[pyfunction]
fn write_statistics(
    py: Python<'_>,
    path: PathBuf,
    episodes: PathBuf,
    statistics: Vec<(String, String)>,
) -> PyResult<()> {
    let parse = |(episode_id, text): (String, String)| {
        let targets = from_json(&format!("statistics of `{episode_id}`"), &text)?;
        Ok(Witness { episode_id, targets })
    };
    let witnesses: Vec<Witness> = statistics.into_iter().map(parse).collect::<PyResult<_>>()?;
    enter(py, || episode::write_statistics(&path, &episodes, &witnesses))
}

/// Adds this file's classes and functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Stage>()?;
    module.add_class::<World>()?;
    module.add_function(wrap_pyfunction!(action_mask, module)?)?;
    module.add_function(wrap_pyfunction!(apply_action, module)?)?;
    module.add_function(wrap_pyfunction!(seed_viewpoints, module)?)?;
    module.add_function(wrap_pyfunction!(read_episodes, module)?)?;
    module.add_function(wrap_pyfunction!(write_episodes, module)?)?;
    module.add_function(wrap_pyfunction!(statistics_path, module)?)?;
    module.add_function(wrap_pyfunction!(read_statistics, module)?)?;
    module.add_function(wrap_pyfunction!(write_statistics, module)?)?;
    module.add_function(wrap_pyfunction!(default_difficulty, module)?)?;
    module.add_function(wrap_pyfunction!(kin_categories, module)?)?;
    module.add_function(wrap_pyfunction!(moves_to_all, module)?)
}
