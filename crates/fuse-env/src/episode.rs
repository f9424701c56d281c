//! Episodes: their file format (Habitat-like `.json.gz`, `{"episodes": [...]}`) and its checks.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::path::Path;

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use glam::{Affine3A, Quat, Vec3};
use serde::{Deserialize, Serialize};

use crate::catalogue::{Catalogue, Category, Split};
use crate::configuration::SceneConfiguration;
use crate::ring::{RingError, VIEWPOINTS, Viewpoint};
use crate::targets::TargetStatistics;

/// Version of the format that this build reads and writes.
pub const EPISODE_SCHEMA_VERSION: u32 = 1;
/// Size of a file's text up to which it is read: some ten thousand episodes.
const LARGEST_BYTES: u64 = 512 << 20;
/// Bounds of the share of the target that shows in the start view.
pub const START_FRACTION: [f32; 2] = [0.05, 0.6];

/// A rotation as named fields.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quaternion {
    /// Real part.
    pub w: f32,
    /// First imaginary part.
    pub x: f32,
    /// Second imaginary part.
    pub y: f32,
    /// Third imaginary part.
    pub z: f32,
}

/// An object of an episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeObject {
    /// Id in the instance images, from 1.
    pub instance_id: u32,
    /// Object of the catalogue.
    pub model_id: String,
    /// What it is.
    pub category: Category,
    /// Position of the model's origin, metres.
    pub translation: [f32; 3],
    /// Rotation model → world, of unit length.
    pub rotation: Quaternion,
}

impl EpisodeObject {
    /// World from model.
    pub fn transform(&self) -> Affine3A {
        let q = self.rotation;
        Affine3A::from_rotation_translation(Quat::from_xyzw(q.x, q.y, q.z, q.w), Vec3::from_array(self.translation))
    }
}

/// One search: a query, a laid table, a start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Episode {
    /// [`EPISODE_SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Unique in its file.
    pub episode_id: String,
    /// Name of the scene configuration.
    pub scene_id: String,
    /// Split of scene and objects.
    pub split: Split,
    /// Seed that generated it.
    pub seed: u64,
    /// What is asked for, in words.
    pub query: String,
    /// The query's verb.
    pub verb: String,
    /// Instance id of the sampled target.
    pub target: u32,
    /// Everything on the table.
    pub objects: Vec<EpisodeObject>,
    /// Instance ids of all objects that a reasonable person would accept, the target first.
    pub valid_target_ids: Vec<u32>,
    /// Instance ids of everything but the target.
    pub distractor_ids: Vec<u32>,
    /// Candidate labels by name of their source; may be empty.
    pub candidate_sets: BTreeMap<String, Vec<String>>,
    /// Ring node of the start, 0 to 35.
    pub start_node: u32,
    /// Pitch index of the start, 0 to 2 for 15°, 30° and 45° down.
    pub start_pitch: u32,
    /// What the 108 viewpoints see of each valid target, in the order of `valid_target_ids`.
    pub statistics: Vec<TargetStatistics>,
}

/// Why an episode or a file of them was refused.
#[derive(Debug, thiserror::Error)]
pub enum EpisodeError {
    /// A file could not be read or written.
    #[error("cannot access episode file {path}: {source}")]
    Io {
        /// File name.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// Unpacked, the file would be larger than any set of episodes.
    #[error("{path} unpacks to more than {} MiB, too much for an episode file", LARGEST_BYTES >> 20)]
    TooLarge {
        /// File name.
        path: String,
    },
    /// The file's own version is another.
    #[error("{path} has schema version {found}, expected {EPISODE_SCHEMA_VERSION}")]
    FileVersion {
        /// File name.
        path: String,
        /// What it says.
        found: u32,
    },
    /// The file is no gzip stream, or ends early.
    #[error("{path} is not a complete gzip file: {source}")]
    Gzip {
        /// File name.
        path: String,
        /// What the decoder said.
        source: std::io::Error,
    },
    /// Not the expected JSON.
    #[error("{path} is not an episode file: {source}")]
    Json {
        /// File name.
        path: String,
        /// Line, column and what was expected.
        source: serde_json::Error,
    },
    /// Another version.
    #[error("episode `{episode}` has schema version {found}, expected {EPISODE_SCHEMA_VERSION}")]
    Version {
        /// Episode id.
        episode: String,
        /// Version found.
        found: u64,
    },
    /// Contents that do not fit together.
    #[error("episode `{episode}`: {reason}")]
    Invalid {
        /// Episode id.
        episode: String,
        /// What was found and what was expected.
        reason: String,
    },
}

#[derive(Serialize)]
struct FileOut<'a> {
    schema_version: u32,
    episodes: &'a [Episode],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "an object with `schema_version` and `episodes`")]
struct FileIn {
    schema_version: u32,
    episodes: Vec<serde_json::Value>,
}

impl Episode {
    /// Reads one episode from JSON; the version is looked at first, so that an episode of another
    /// version is refused as such.
    pub fn from_json(text: &str) -> Result<Self, EpisodeError> {
        let json = |source| EpisodeError::Json { path: "episode".into(), source };
        Self::from_value(serde_json::from_str(text).map_err(json)?, "episode")
    }

    fn from_value(value: serde_json::Value, path: &str) -> Result<Self, EpisodeError> {
        let found = value.get("schema_version").and_then(serde_json::Value::as_u64);
        if let Some(found) = found.filter(|v| *v != u64::from(EPISODE_SCHEMA_VERSION)) {
            let episode = value.get("episode_id").and_then(|v| v.as_str()).unwrap_or("without id").to_owned();
            return Err(EpisodeError::Version { episode, found });
        }
        serde_json::from_value(value).map_err(|source| EpisodeError::Json { path: path.to_owned(), source })
    }

    /// Where the episode starts.
    pub fn start(&self) -> Result<Viewpoint, RingError> {
        Viewpoint::new(self.start_node, self.start_pitch)
    }

    /// The object with an instance id.
    pub fn object(&self, instance: u32) -> Option<&EpisodeObject> {
        self.objects.iter().find(|o| o.instance_id == instance)
    }

    /// Checks that the episode is complete and fits the catalogue and the scenes.
    pub fn validate(&self, catalogue: &Catalogue, scenes: &[SceneConfiguration]) -> Result<(), EpisodeError> {
        self.check_world(catalogue, scenes)
            .and_then(|()| self.check_ids())
            .and_then(|()| self.check_start())
            .map_err(|reason| EpisodeError::Invalid { episode: self.episode_id.clone(), reason })
    }

    fn check_world(&self, catalogue: &Catalogue, scenes: &[SceneConfiguration]) -> Result<(), String> {
        let scene = crate::configuration::find(scenes, &self.scene_id).map_err(|e| e.to_string())?;
        if scene.split != self.split {
            return Err(format!("split {} in scene `{}` of split {}", self.split, scene.name, scene.split));
        }
        for object in &self.objects {
            let id = &object.model_id;
            let record = catalogue.get(id).ok_or_else(|| format!("unknown object `{id}`"))?;
            if record.category != object.category {
                return Err(format!("object `{id}` is a {}, found category {}", record.category, object.category));
            }
            if record.split != self.split {
                return Err(format!("object `{id}` belongs to split {}, expected {}", record.split, self.split));
            }
            let q = object.rotation;
            let norm = Quat::from_xyzw(q.x, q.y, q.z, q.w).length();
            if !object.translation.iter().all(|v| v.is_finite()) || !(0.999..=1.001).contains(&norm) {
                return Err(format!("object `{id}` has no finite position or no unit rotation"));
            }
        }
        Ok(())
    }

    fn check_ids(&self) -> Result<(), String> {
        let mut ids: Vec<u32> = self.objects.iter().map(|o| o.instance_id).collect();
        ids.sort_unstable();
        if ids.first() == Some(&0) || ids.windows(2).any(|w| w[0] == w[1]) {
            return Err("instance ids must be unique and not 0".into());
        }
        if ids.binary_search(&self.target).is_err() {
            return Err(format!("target {} is not among the objects", self.target));
        }
        if self.valid_target_ids.first() != Some(&self.target) {
            return Err(format!("valid_target_ids must begin with the target {}", self.target));
        }
        if let Some(id) = self.valid_target_ids.iter().find(|id| ids.binary_search(id).is_err()) {
            return Err(format!("valid target {id} is not among the objects"));
        }
        let mut others = self.distractor_ids.clone();
        others.sort_unstable();
        ids.retain(|id| *id != self.target);
        if others != ids {
            return Err("distractor_ids must name every object but the target".into());
        }
        if !(7..=14).contains(&others.len()) {
            return Err(format!("{} distractors, expected 7 to 14", others.len()));
        }
        Ok(())
    }

    fn check_start(&self) -> Result<(), String> {
        let start = self.start().map_err(|e| format!("start: {e}"))?;
        if self.statistics.iter().map(|s| s.instance_id).ne(self.valid_target_ids.iter().copied()) {
            return Err("statistics must follow valid_target_ids one to one".into());
        }
        for s in &self.statistics {
            if s.visible_px.len() != VIEWPOINTS || s.unoccluded_px.len() != VIEWPOINTS {
                return Err(format!("statistics of {} must have {VIEWPOINTS} views", s.instance_id));
            }
        }
        let fraction = self.statistics[0].fraction(start);
        if !(START_FRACTION[0]..=START_FRACTION[1]).contains(&fraction) {
            return Err(format!("the start view shows {fraction:.3} of the target, expected {START_FRACTION:?}"));
        }
        Ok(())
    }
}

/// Reads a `.json.gz` file. Checks form and version; [`Episode::validate`] checks contents.
pub fn read(path: &Path) -> Result<Vec<Episode>, EpisodeError> {
    let name = path.display().to_string();
    let bytes = std::fs::read(path).map_err(|source| EpisodeError::Io { path: name.clone(), source })?;
    let mut text = Vec::new();
    GzDecoder::new(bytes.as_slice())
        .take(LARGEST_BYTES + 1)
        .read_to_end(&mut text)
        .map_err(|source| EpisodeError::Gzip { path: name.clone(), source })?;
    if text.len() as u64 > LARGEST_BYTES {
        return Err(EpisodeError::TooLarge { path: name });
    }
    let file: FileIn =
        serde_json::from_slice(&text).map_err(|source| EpisodeError::Json { path: name.clone(), source })?;
    if file.schema_version != EPISODE_SCHEMA_VERSION {
        return Err(EpisodeError::FileVersion { path: name, found: file.schema_version });
    }
    let episodes = file.episodes.into_iter().map(|v| Episode::from_value(v, &name)).collect::<Result<Vec<_>, _>>()?;
    for (i, e) in episodes.iter().enumerate() {
        if episodes[..i].iter().any(|o| o.episode_id == e.episode_id) {
            return Err(EpisodeError::Invalid { episode: e.episode_id.clone(), reason: "appears twice".into() });
        }
    }
    Ok(episodes)
}

/// Writes a `.json.gz` file: the same bytes for the same episodes, whole or not at all.
pub fn write(path: &Path, episodes: &[Episode]) -> Result<(), EpisodeError> {
    let name = path.display().to_string();
    let io = |source| EpisodeError::Io { path: name.clone(), source };
    let text = serde_json::to_vec(&FileOut { schema_version: EPISODE_SCHEMA_VERSION, episodes })
        .map_err(|source| EpisodeError::Json { path: name.clone(), source })?;
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(&text).map_err(io)?;
    let bytes = encoder.finish().map_err(io)?;
    let mut partial = path.as_os_str().to_owned();
    partial.push(format!(".{}.part", std::process::id()));
    let partial = Path::new(&partial);
    std::fs::write(partial, bytes).and_then(|()| std::fs::rename(partial, path)).map_err(|source| {
        // What is left of a failed write is of no use; that it failed is what is reported.
        drop(std::fs::remove_file(partial));
        io(source)
    })
}
