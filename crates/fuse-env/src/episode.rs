//! Episodes: what one is and its JSON. `files` has the files of sets, `checks` what makes an episode sound.

mod checks;
mod files;

use std::collections::BTreeMap;

use glam::{Affine3A, Quat, Vec3};
use serde::{Deserialize, Serialize};

use crate::catalogue::{Category, Split};
use crate::ring::{RingError, Viewpoint};

pub use files::{
    EpisodeSet, Generation, Witness, read, read_statistics, statistics_path, unpacked_sha256, write, write_statistics,
};

/// Version of the episode files and of the statistics files beside them that this build reads and writes.
pub const EPISODE_SCHEMA_VERSION: u32 = 2;
/// Bounds of the share of the target that shows in the start view.
pub const START_FRACTION: [f32; 2] = [0.05, 0.6];
/// Share of the target that some reachable view must show at least.
pub const GOOD_FRACTION: f32 = 0.8;
/// Pixels that show it in that view, at least: the smallest region that may end a search.
pub const GOOD_PX: u32 = 500;
/// Fewest and most distractors.
pub const DISTRACTORS: [u32; 2] = [7, 14];
/// Actions within which that view must be reached: T of the paper.
pub const MOST_MOVES: u32 = 30;

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
    /// Pixels that show the target in the start view.
    pub start_px: u32,
    /// Share of what could be seen of the target in the start view, within [`START_FRACTION`].
    pub start_fraction: f32,
    /// Ring node of the view that shows most of the target, among the reachable ones that show it well.
    pub best_node: u32,
    /// Pitch index of that view.
    pub best_pitch: u32,
    /// Pixels that show the target in that view, at least [`GOOD_PX`].
    pub best_px: u32,
    /// Share of what could be seen of the target in that view, at least [`GOOD_FRACTION`].
    pub best_fraction: f32,
    /// Fewest actions from the start to a view that shows the target well, 1 to [`MOST_MOVES`].
    pub moves_to_good_view: u32,
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
    #[error("{path} unpacks to more than {} MiB, too much for an episode file", files::LARGEST_BYTES >> 20)]
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
    #[error("{path} is not {what}: {source}")]
    Json {
        /// File name.
        path: String,
        /// What it should be.
        what: &'static str,
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
    /// A statistics file that was made with other episodes.
    #[error(
        "{path} belongs to another episode file: it names SHA-256 {}…, {episodes} unpacks to {}…",
        short(found),
        short(expected)
    )]
    Foreign {
        /// Statistics file.
        path: String,
        /// Episode file.
        episodes: String,
        /// Digest that the statistics name.
        found: String,
        /// Digest of the episodes.
        expected: String,
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

fn short(digest: &str) -> &str {
    digest.get(..12).unwrap_or(digest)
}

const EPISODE: &str = "an episode";

impl Episode {
    /// Reads one episode from JSON; the version is looked at first, so that an episode of another
    /// version is refused as such.
    pub fn from_json(text: &str) -> Result<Self, EpisodeError> {
        let json = |source| EpisodeError::Json { path: "episode".into(), what: EPISODE, source };
        Self::from_value(serde_json::from_str(text).map_err(json)?, "episode")
    }

    fn from_value(value: serde_json::Value, path: &str) -> Result<Self, EpisodeError> {
        let found = value.get("schema_version").and_then(serde_json::Value::as_u64);
        if let Some(found) = found.filter(|v| *v != u64::from(EPISODE_SCHEMA_VERSION)) {
            let episode = value.get("episode_id").and_then(|v| v.as_str()).unwrap_or("without id").to_owned();
            return Err(EpisodeError::Version { episode, found });
        }
        let json = |source| EpisodeError::Json { path: path.to_owned(), what: "an episode file", source };
        serde_json::from_value(value).map_err(json)
    }

    /// Where the episode starts.
    pub fn start(&self) -> Result<Viewpoint, RingError> {
        Viewpoint::new(self.start_node, self.start_pitch)
    }

    /// The view that shows most of the target.
    pub fn best(&self) -> Result<Viewpoint, RingError> {
        Viewpoint::new(self.best_node, self.best_pitch)
    }

    /// The object with an instance id.
    pub fn object(&self, instance: u32) -> Option<&EpisodeObject> {
        self.objects.iter().find(|o| o.instance_id == instance)
    }
}
