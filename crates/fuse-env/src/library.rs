//! A user's folder of objects: `catalogue.json`, a GLB and a picture each.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::catalogue::{Catalogue, CatalogueError, Category, FILE_NAME, File, VERSION};
use crate::import::Import;

/// What a library says about a category: it must name each that the shipped set has not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CategoryEntry {
    /// The category.
    pub id: Category,
    /// Verbs that it is valid for, each with the reason.
    pub valid_for: BTreeMap<String, String>,
}

/// Reason of an entry that a user gave.
pub const STATED: &str = "stated by the user";

/// Puts an object into a library, which is made when there is none. `verbs`: what its category is
/// valid for. The model and its picture (PNG) are in place before the list names them, and each file
/// is there whole or not at all.
///
/// # Errors
/// [`CatalogueError::Exists`] when the library has an object of that name and not `replace`;
/// [`CatalogueError::Io`]; those of [`Catalogue::load`] when the library is not sound.
pub fn add(
    directory: &Path,
    import: &Import,
    png: &[u8],
    verbs: &[String],
    replace: bool,
) -> Result<(), CatalogueError> {
    let io = |path: &Path| {
        let path = path.display().to_string();
        move |source| CatalogueError::Io { path, source }
    };
    let new = !directory.exists();
    std::fs::create_dir_all(directory).map_err(io(directory))?;
    let list = directory.join(FILE_NAME);
    let mut file = if list.exists() {
        Catalogue::load(directory)?;
        File::read(directory)?
    } else {
        if !new && std::fs::read_dir(directory).map_err(io(directory))?.next().is_some() {
            let path = list.display().to_string();
            let reason = "there is none, and the folder is not empty; expected a library or a new folder".into();
            return Err(CatalogueError::Invalid { path, reason });
        }
        File {
            version: VERSION,
            licence: "as stated by the models' makers".into(),
            categories: vec![],
            objects: vec![],
        }
    };
    let record = &import.record;
    match file.objects.iter_mut().find(|r| r.id == record.id) {
        Some(_) if !replace => {
            return Err(CatalogueError::Exists { id: record.id.clone(), library: directory.display().to_string() });
        }
        Some(old) => *old = record.clone(),
        None => file.objects.push(record.clone()),
    }
    state(&mut file, record.category, verbs);
    let mut text = serde_json::to_string_pretty(&file)
        .map_err(|e| CatalogueError::Invalid { path: list.display().to_string(), reason: e.to_string() })?;
    text.push('\n');
    let model = directory.join(&record.file);
    write(&model, &fuse_render::to_glb(&import.model)).map_err(io(&model))?;
    let picture = directory.join(&record.id).with_extension("png");
    write(&picture, png).map_err(io(&picture))?;
    write(&list, text.as_bytes()).map_err(io(&list))
}

/// Names a category and what it is valid for; entries that are there stay.
fn state(file: &mut File, category: Category, verbs: &[String]) {
    let at = file.categories.iter().position(|c| c.id == category).unwrap_or_else(|| {
        file.categories.push(CategoryEntry { id: category, valid_for: BTreeMap::new() });
        file.categories.len() - 1
    });
    for verb in verbs {
        file.categories[at].valid_for.entry(verb.clone()).or_insert_with(|| STATED.to_owned());
    }
}

/// Writes a file whole or not at all: beside it, to the disk, then in its place.
fn write(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(format!(".{}.part", std::process::id()));
    let partial = PathBuf::from(partial);
    let put = || {
        let mut file = std::fs::File::create(&partial)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&partial, path)
    };
    put().inspect_err(|_| {
        // What is left of a failed write is of no use; that it failed is what is reported.
        drop(std::fs::remove_file(&partial));
    })
}
