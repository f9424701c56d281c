#![no_main]

use std::path::Path;
use std::sync::OnceLock;

use tempfile::TempDir;

/// The reader takes paths: bytes go through a file in memory, where the system has one.
fn folder() -> &'static Path {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    let memory = Path::new("/dev/shm");
    let make = || if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
    FOLDER.get_or_init(|| make().expect("a temporary folder can be made")).path()
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let path = folder().join("model.obj");
    std::fs::write(&path, bytes).expect("the temporary folder is written");
    if let Ok(model) = fuse_render::load(&path) {
        model.check().expect("what is taken is sound");
    }
});
