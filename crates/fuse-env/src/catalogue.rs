//! The objects that scenes are made of: categories, records, model files.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use fuse_render::{Model, ModelError};
use glam::{Quat, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub use crate::category::Category;
use crate::import::Imported;
use crate::library::CategoryEntry;

/// Which part of the work an object or scene may be used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Training.
    Train,
    /// Tuning and demonstrations.
    Dev,
    /// Evaluation only.
    Eval,
}

impl Split {
    /// Every split.
    pub const ALL: [Self; 3] = [Self::Train, Self::Dev, Self::Eval];

    /// Identifier in files and commands.
    pub const fn id(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Dev => "dev",
            Self::Eval => "eval",
        }
    }

    /// Instances per category in the shipped catalogue.
    pub const fn instances(self) -> u64 {
        match self {
            Self::Train => 5,
            Self::Dev => 1,
            Self::Eval => 2,
        }
    }
}

impl fmt::Display for Split {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.id())
    }
}

impl FromStr for Split {
    type Err = CatalogueError;

    fn from_str(id: &str) -> Result<Self, CatalogueError> {
        Self::ALL.into_iter().find(|s| s.id() == id).ok_or_else(|| CatalogueError::UnknownSplit(id.into()))
    }
}

/// A way in which a thing rests on a table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RestingPose {
    /// Rotation from the model's axes to the world's, `[x, y, z, w]`.
    pub quaternion: [f32; 4],
    /// How far the model's origin is above the table, metres.
    pub height: f32,
    /// Share of throws that end so; a record's poses sum to 1.
    pub probability: f32,
}

impl RestingPose {
    /// The rotation as glam's type.
    pub fn rotation(&self) -> Quat {
        Quat::from_array(self.quaternion)
    }
}

/// One object of the catalogue.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectRecord {
    /// Unique name, for example `knife_train_0`.
    pub id: String,
    /// What it is.
    pub category: Category,
    /// What it may be used for.
    pub split: Split,
    /// Model file, relative to the catalogue's folder.
    pub file: String,
    /// Extent along x, y, z of the model in its natural pose, metres.
    pub size_m: [f32; 3],
    /// Stable poses, most probable first.
    pub resting: Vec<RestingPose>,
    /// Seed that generates it, see [`crate::objects::generate`]; `None` for an imported one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Where an imported one comes from and what was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub imported: Option<Imported>,
}

/// Why a catalogue was refused.
#[derive(Debug, thiserror::Error)]
pub enum CatalogueError {
    /// An id that is no category.
    #[error("unknown category `{found}`, expected one of: {known}")]
    UnknownCategory {
        /// The id.
        found: String,
        /// All known ids.
        known: String,
    },
    /// A name that cannot be a category's.
    #[error(
        "a category is named with lower-case letters, digits and `_`, a letter first, 48 characters at most; \
         found `{0}`"
    )]
    CategoryName(String),
    /// More categories than a process keeps.
    #[error("more than {0} categories that the shipped set does not have, too many for one process")]
    TooManyCategories(usize),
    /// An id that is no split.
    #[error("unknown split `{0}`, expected train, dev or eval")]
    UnknownSplit(String),
    /// The library has an object of that name.
    #[error("object `{id}` is in {library} already; --replace puts the new one in its place")]
    Exists {
        /// The object.
        id: String,
        /// The folder.
        library: String,
    },
    /// Two folders have objects of the same name.
    #[error("object `{id}` is in {first} and in {second}, expected different ids")]
    Twice {
        /// The object.
        id: String,
        /// A folder.
        first: String,
        /// Another, or the same again.
        second: String,
    },
    /// A file could not be read or written.
    #[error("cannot access {path}: {source}")]
    Io {
        /// File name.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// `catalogue.json` is not what it should be.
    #[error("{path} is not an object catalogue: {reason}")]
    Invalid {
        /// File name.
        path: String,
        /// What was found and what was expected.
        reason: String,
    },
    /// A model file of the catalogue is missing or broken.
    #[error("object `{id}`: {source}")]
    Model {
        /// The object.
        id: String,
        /// What is wrong with its file.
        source: ModelError,
    },
}

/// Objects in one folder or several: each has a `catalogue.json` and the model files that it names.
#[derive(Clone, Debug)]
pub struct Catalogue {
    /// Each folder with the number of records up to its last.
    folders: Vec<(PathBuf, usize)>,
    records: Vec<ObjectRecord>,
    categories: Vec<CategoryEntry>,
}

/// Layout of `catalogue.json`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields, expecting = "an object with `version`, `licence` and `objects`")]
pub(crate) struct File {
    pub(crate) version: u32,
    pub(crate) licence: String,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) categories: Vec<CategoryEntry>,
    pub(crate) objects: Vec<ObjectRecord>,
}

/// Format version of `catalogue.json`.
pub(crate) const VERSION: u32 = 1;
/// Name of the file that lists a folder's objects.
pub(crate) const FILE_NAME: &str = "catalogue.json";
/// Size of a catalogue's text up to which it is read.
const LARGEST_BYTES: u64 = 256 << 20;

impl File {
    /// Reads and checks a folder's list; that the models exist is not looked at.
    pub(crate) fn read(directory: &Path) -> Result<Self, CatalogueError> {
        let path = directory.join(FILE_NAME);
        let name = path.display().to_string();
        let io = |source| CatalogueError::Io { path: name.clone(), source };
        let invalid = |reason: String| CatalogueError::Invalid { path: name.clone(), reason };
        if std::fs::metadata(&path).map_err(io)?.len() > LARGEST_BYTES {
            return Err(invalid(format!("it has more than {} MiB", LARGEST_BYTES >> 20)));
        }
        let text = std::fs::read_to_string(&path).map_err(io)?;
        let file: Self = serde_json::from_str(&text).map_err(|e| invalid(e.to_string()))?;
        if file.version != VERSION {
            return Err(invalid(format!("version {}, expected {VERSION}", file.version)));
        }
        let mut seen = std::collections::HashSet::new();
        for record in &file.objects {
            check(record).map_err(|reason| invalid(format!("object `{}`: {reason}", record.id)))?;
            if !seen.insert(record.id.as_str()) {
                return Err(invalid(format!("object `{}` appears twice", record.id)));
            }
            let category = record.category;
            if category.is_own() && !file.categories.iter().any(|c| c.id == category) {
                return Err(invalid(format!(
                    "object `{}`: unknown category `{category}`, neither one of the shipped set nor named under \
                     `categories`",
                    record.id
                )));
            }
        }
        Ok(file)
    }
}

impl Catalogue {
    /// Reads `directory/catalogue.json` and checks every record and that every model file is
    /// there.
    ///
    /// # Errors
    /// [`CatalogueError`] naming the file and what is wrong with it.
    pub fn load(directory: impl AsRef<Path>) -> Result<Self, CatalogueError> {
        Self::load_all(&[directory])
    }

    /// Several folders as one catalogue, in their order.
    ///
    /// # Errors
    /// As [`Catalogue::load`]; also [`CatalogueError::Twice`] when two folders share an id.
    pub fn load_all(directories: &[impl AsRef<Path>]) -> Result<Self, CatalogueError> {
        let mut all = Self { folders: vec![], records: vec![], categories: vec![] };
        let mut home = std::collections::HashMap::<String, usize>::new();
        for (i, directory) in directories.iter().enumerate() {
            let directory = directory.as_ref().to_path_buf();
            let file = File::read(&directory)?;
            for record in &file.objects {
                let model = directory.join(&record.file);
                std::fs::metadata(&model)
                    .map_err(|source| CatalogueError::Io { path: model.display().to_string(), source })?;
                if let Some(first) = home.insert(record.id.clone(), i) {
                    let name = |i: usize| directories[i].as_ref().display().to_string();
                    return Err(CatalogueError::Twice { id: record.id.clone(), first: name(first), second: name(i) });
                }
            }
            all.records.extend(file.objects);
            all.categories.extend(file.categories);
            all.folders.push((directory, all.records.len()));
        }
        Ok(all)
    }

    /// What the folders say about categories.
    pub fn categories(&self) -> &[CategoryEntry] {
        &self.categories
    }

    /// The category called `id`: one of the shipped set or of this catalogue.
    ///
    /// # Errors
    /// [`CatalogueError::UnknownCategory`].
    pub fn category(&self, id: &str) -> Result<Category, CatalogueError> {
        let own = self.categories.iter().map(|c| c.id).find(|c| c.id() == id);
        own.map_or_else(|| id.parse(), Ok)
    }

    /// All records, in file order.
    pub fn records(&self) -> &[ObjectRecord] {
        &self.records
    }

    /// The record with an id.
    pub fn get(&self, id: &str) -> Option<&ObjectRecord> {
        self.records.iter().find(|r| r.id == id)
    }

    /// Records of a split.
    pub fn of(&self, split: Split) -> impl Iterator<Item = &ObjectRecord> {
        self.records.iter().filter(move |r| r.split == split)
    }

    /// Where a record's model file lies.
    pub fn path(&self, record: &ObjectRecord) -> PathBuf {
        let at = self.records.iter().position(|r| r.id == record.id).unwrap_or(0);
        let home = self.folders.iter().find(|(_, end)| at < *end).map_or(Path::new(""), |(folder, _)| folder);
        home.join(&record.file)
    }

    /// Loads a record's model.
    ///
    /// # Errors
    /// [`CatalogueError::Model`] when the file is missing, truncated or no sound model.
    pub fn model(&self, record: &ObjectRecord) -> Result<Model, CatalogueError> {
        fuse_render::load(self.path(record)).map_err(|source| CatalogueError::Model { id: record.id.clone(), source })
    }
}

/// What is wrong with a record's numbers, if anything.
fn check(record: &ObjectRecord) -> Result<(), String> {
    if !record.size_m.iter().all(|s| s.is_finite() && *s > 0.0) {
        return Err(format!("size_m must be three positive numbers, found {:?}", record.size_m));
    }
    if record.resting.is_empty() {
        return Err("needs at least one resting pose".into());
    }
    for pose in &record.resting {
        let norm = pose.rotation().length();
        if !norm.is_finite() || (norm - 1.0).abs() > 1e-3 {
            return Err(format!("resting quaternion {:?} is not of unit length", pose.quaternion));
        }
        if !(pose.height.is_finite() && (0.0..=1.0).contains(&pose.probability)) {
            return Err(format!("resting height {} or probability {} is out of range", pose.height, pose.probability));
        }
    }
    if Path::new(&record.file).components().any(|c| !matches!(c, std::path::Component::Normal(_))) {
        return Err(format!("file `{}` must be a path inside the catalogue's folder", record.file));
    }
    Ok(())
}

fn no_generator(category: Category) -> CatalogueError {
    let known = Category::ALL.iter().map(|c| c.id()).collect::<Vec<_>>().join(", ");
    CatalogueError::UnknownCategory { found: category.id().into(), known }
}

/// Seed of the shipped catalogue's first instance of every category and split.
const FIRST_SEED: u64 = 10;

/// The record and the model of one object of the shipped catalogue: instance `index` of a
/// category and split; `None` for a category without a generator.
pub fn make(category: Category, split: Split, index: u64) -> Option<(ObjectRecord, Model)> {
    let seed = FIRST_SEED + index;
    let model = crate::objects::generate(category, split, seed)?;
    let (low, high) = model.bounds().unwrap_or((Vec3::ZERO, Vec3::ZERO));
    let id = format!("{category}_{split}_{index}");
    let resting = crate::objects::resting::resting_poses(&model, category.natural_share());
    let record = ObjectRecord {
        file: format!("{id}.glb"),
        id,
        category,
        split,
        size_m: (high - low).to_array(),
        resting,
        seed: Some(seed),
        imported: None,
    };
    Some((record, model))
}

/// Writes the shipped catalogue, or the categories given, into `directory`: a GLB per object and
/// `catalogue.json`, the same bytes every time. Returns the records.
///
/// # Errors
/// [`CatalogueError::Io`] when the folder cannot be made or written.
pub fn write(directory: impl AsRef<Path>, categories: &[Category]) -> Result<Vec<ObjectRecord>, CatalogueError> {
    let directory = directory.as_ref();
    let io = |path: &Path| {
        let path = path.display().to_string();
        move |source| CatalogueError::Io { path, source }
    };
    std::fs::create_dir_all(directory).map_err(io(directory))?;
    let jobs: Vec<(Category, Split, u64)> = categories
        .iter()
        .flat_map(|&c| Split::ALL.into_iter().flat_map(move |s| (0..s.instances()).map(move |i| (c, s, i))))
        .collect();
    let objects = jobs
        .into_par_iter()
        .map(|(category, split, index)| {
            let (record, model) = make(category, split, index).ok_or_else(|| no_generator(category))?;
            let path = directory.join(&record.file);
            std::fs::write(&path, fuse_render::to_glb(&model)).map_err(io(&path))?;
            Ok(record)
        })
        .collect::<Result<Vec<_>, _>>()?;
    let path = directory.join(FILE_NAME);
    let file = File { version: VERSION, licence: "CC0-1.0".into(), categories: vec![], objects };
    let mut text = serde_json::to_string_pretty(&file)
        .map_err(|e| CatalogueError::Invalid { path: path.display().to_string(), reason: e.to_string() })?;
    text.push('\n');
    std::fs::write(&path, text).map_err(io(&path))?;
    Ok(file.objects)
}
