//! Files appear whole or not at all.

use std::io::Write as _;
use std::path::Path;

use crate::SplatError;

/// Writes to a temporary name beside `path`, syncs and renames.
///
/// # Errors
/// If the file cannot be written.
pub(crate) fn write(path: &Path, parts: &[&[u8]]) -> Result<(), SplatError> {
    let fail = |e| SplatError::io(path, e);
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut file = tempfile::NamedTempFile::new_in(folder).map_err(fail)?;
    for part in parts {
        file.write_all(part).map_err(fail)?;
    }
    file.as_file().sync_all().map_err(fail)?;
    share(file.as_file()).map_err(fail)?;
    file.persist(path).map_err(|e| fail(e.error))?;
    Ok(())
}

/// Reads a whole file.
///
/// # Errors
/// If it cannot be read.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>, SplatError> {
    std::fs::read(path).map_err(|e| SplatError::io(path, e))
}

/// Temporary files are private; a result is readable like any other file.
#[cfg(unix)]
fn share(file: &std::fs::File) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    file.set_permissions(std::fs::Permissions::from_mode(0o644))
}

#[cfg(not(unix))]
fn share(_: &std::fs::File) -> std::io::Result<()> {
    Ok(())
}
