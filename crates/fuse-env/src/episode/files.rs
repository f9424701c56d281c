//! The files of a set: `NAME.json.gz` with the episodes (Habitat-like, `{"episodes": [...]}`), and beside it
//! `NAME.statistics.json.gz` with what the 108 viewpoints see of every valid target.
//!
//! The second names the SHA-256 of the first's unpacked text, so that statistics of other episodes are refused.
//! Both are the same bytes for the same contents: their gzip headers hold no time and no name.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::{EPISODE_SCHEMA_VERSION, Episode, EpisodeError};
use crate::catalogue::Split;
use crate::difficulty::Difficulty;
use crate::targets::TargetStatistics;

/// Size of a file's text up to which it is read: some ten thousand episodes.
pub(super) const LARGEST_BYTES: u64 = 512 << 20;
const EPISODES: &str = "an episode file";
const STATISTICS: &str = "a statistics file of episodes";

/// How a set was generated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Generation {
    /// Name of the set.
    pub set: String,
    /// Split of scenes and objects.
    pub split: Split,
    /// Number of episodes asked for.
    pub count: u32,
    /// Seed of the set.
    pub seed: u64,
    /// The knobs.
    pub difficulty: Difficulty,
    /// How many layouts were thrown away, by reason.
    pub rejected: BTreeMap<String, u32>,
}

/// A set of episodes, as in its file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EpisodeSet {
    /// [`EPISODE_SCHEMA_VERSION`].
    pub schema_version: u32,
    /// How it was generated; `None` for sets put together by hand.
    pub generation: Option<Generation>,
    /// The episodes, with unique ids.
    pub episodes: Vec<Episode>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "an object with `schema_version`, `generation` and `episodes`")]
struct SetIn {
    schema_version: u32,
    #[serde(default)]
    generation: serde_json::Value,
    episodes: Vec<serde_json::Value>,
}

/// What the viewpoints see of an episode's valid targets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Witness {
    /// The episode.
    pub episode_id: String,
    /// Its valid targets, in the order of `valid_target_ids`.
    pub targets: Vec<TargetStatistics>,
}

#[derive(Serialize)]
struct StatisticsOut<'a> {
    schema_version: u32,
    episodes_sha256: &'a str,
    statistics: &'a [Witness],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "an object with `schema_version`, `episodes_sha256` and `statistics`")]
struct StatisticsIn {
    #[expect(dead_code, reason = "must be there; `Versioned` has read it")]
    schema_version: u32,
    episodes_sha256: String,
    statistics: Vec<Witness>,
}

/// The schema version alone, so that files of another version are refused as such.
#[derive(Deserialize)]
struct Versioned {
    schema_version: Option<u32>,
}

fn json<T: for<'de> Deserialize<'de>>(text: &[u8], path: &str, what: &'static str) -> Result<T, EpisodeError> {
    let error = |source| EpisodeError::Json { path: path.to_owned(), what, source };
    // Not an object at all is for the proper reading to tell.
    if let Ok(Versioned { schema_version: Some(found) }) = serde_json::from_slice(text)
        && found != EPISODE_SCHEMA_VERSION
    {
        return Err(EpisodeError::FileVersion { path: path.to_owned(), found });
    }
    serde_json::from_slice(text).map_err(error)
}

fn unpack(path: &Path) -> Result<Vec<u8>, EpisodeError> {
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
    Ok(text)
}

fn hexadecimal(text: &[u8]) -> String {
    Sha256::digest(text).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// SHA-256 of a file's unpacked text: what its statistics name.
pub fn unpacked_sha256(path: &Path) -> Result<String, EpisodeError> {
    Ok(hexadecimal(&unpack(path)?))
}

/// Where the statistics of an episode file lie: `NAME.statistics.json.gz` beside `NAME.json.gz`.
pub fn statistics_path(episodes: &Path) -> PathBuf {
    let name = episodes.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name.strip_suffix(".json.gz").unwrap_or(&name);
    episodes.with_file_name(format!("{stem}.statistics.json.gz"))
}

/// Reads the episodes of a `.json.gz` file. Checks form and version; [`Episode::validate`] checks contents.
pub fn read(path: &Path) -> Result<EpisodeSet, EpisodeError> {
    let name = path.display().to_string();
    let file: SetIn = json(&unpack(path)?, &name, EPISODES)?;
    let error = |source| EpisodeError::Json { path: name.clone(), what: EPISODES, source };
    let generation = serde_json::from_value(file.generation).map_err(error)?;
    let episodes = file.episodes.into_iter().map(|v| Episode::from_value(v, &name)).collect::<Result<Vec<_>, _>>()?;
    let mut ids = BTreeSet::new();
    if let Some(e) = episodes.iter().find(|e| !ids.insert(&e.episode_id)) {
        return Err(EpisodeError::Invalid { episode: e.episode_id.clone(), reason: "appears twice".into() });
    }
    Ok(EpisodeSet { schema_version: file.schema_version, generation, episodes })
}

/// Reads the statistics of an episode file; refuses those of another, and those that do not fit its episodes.
pub fn read_statistics(path: &Path, episodes: &Path) -> Result<Vec<Witness>, EpisodeError> {
    let name = path.display().to_string();
    let file: StatisticsIn = json(&unpack(path)?, &name, STATISTICS)?;
    let expected = unpacked_sha256(episodes)?;
    if file.episodes_sha256 != expected {
        let episodes = episodes.display().to_string();
        return Err(EpisodeError::Foreign { path: name, episodes, found: file.episodes_sha256, expected });
    }
    let set = read(episodes)?;
    let ids = set.episodes.iter().map(|e| &e.episode_id);
    if file.statistics.iter().map(|w| &w.episode_id).ne(ids) {
        let reason = "its statistics must follow the episodes one to one".into();
        return Err(EpisodeError::Invalid { episode: name, reason });
    }
    for (episode, witness) in set.episodes.iter().zip(&file.statistics) {
        episode.check_statistics(&witness.targets)?;
    }
    Ok(file.statistics)
}

/// Writes an episode file: the same bytes for the same set, whole or not at all.
pub fn write(path: &Path, set: &EpisodeSet) -> Result<(), EpisodeError> {
    pack(path, set, EPISODES)
}

/// Writes the statistics of an episode file that is already there: the same bytes for the same statistics, whole or
/// not at all.
pub fn write_statistics(path: &Path, episodes: &Path, statistics: &[Witness]) -> Result<(), EpisodeError> {
    let episodes_sha256 = &unpacked_sha256(episodes)?;
    pack(path, &StatisticsOut { schema_version: EPISODE_SCHEMA_VERSION, episodes_sha256, statistics }, STATISTICS)
}

fn pack(path: &Path, contents: &impl Serialize, what: &'static str) -> Result<(), EpisodeError> {
    let name = path.display().to_string();
    let io = |source| EpisodeError::Io { path: name.clone(), source };
    let text =
        serde_json::to_vec(contents).map_err(|source| EpisodeError::Json { path: name.clone(), what, source })?;
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(&text).map_err(io)?;
    let bytes = encoder.finish().map_err(io)?;
    let mut partial = path.as_os_str().to_owned();
    partial.push(format!(".{}.part", std::process::id()));
    let partial = Path::new(&partial);
    let written = std::fs::File::create(partial).and_then(|mut file| {
        file.write_all(&bytes)?;
        file.sync_all()
    });
    written.and_then(|()| std::fs::rename(partial, path)).map_err(|source| {
        // What is left of a failed write is of no use; that it failed is what is reported.
        drop(std::fs::remove_file(partial));
        io(source)
    })
}
