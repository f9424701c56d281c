//! The readers take paths: bytes go through a file in memory, where the system has one.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use tempfile::TempDir;

use crate::readers;

fn folder() -> &'static Path {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    let memory = Path::new("/dev/shm");
    let make = || if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
    FOLDER.get_or_init(|| make().expect("a temporary folder can be made")).path()
}

/// Reads `bytes` as a file on its own.
#[allow(dead_code, reason = "each target uses one of the two")]
pub fn file<E>(name: &str, bytes: &[u8], read: fn(&Path) -> Result<(), E>) {
    let path = folder().join(name);
    std::fs::write(&path, bytes).expect("the temporary folder is written");
    let _ = read(&path);
}

/// Reads a photo set in which one file, by the first byte, is `bytes`.
#[allow(dead_code, reason = "each target uses one of the two")]
pub fn photo_set(reader: &str, names: &[&str], bytes: &[u8]) {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data").join(reader);
    let (Some((which, content)), set) = (bytes.split_first(), folder().join(reader)) else { return };
    readers::copy(&source, &set);
    let path: PathBuf = readers::place(reader, &set, names[usize::from(*which) % names.len()]);
    std::fs::write(path, content).expect("the temporary folder is written");
    let _ = readers::photo_set(&set);
}
