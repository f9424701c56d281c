//! PLY files exactly as the original 3DGS writes them: binary little endian, one `vertex` element
//! of 62 floats: x, y, z, nx, ny, nz (zero), f_dc_0..2, f_rest_0..44 (15 of red, then green, then
//! blue), opacity (logit), scale_0..2 (logarithm), rot_0..3 (w first).

use std::io::Write as _;
use std::path::Path;

use crate::constants::{DC, OPACITY, PARAMETERS, POSITION, REST, ROTATION, SCALE};
use crate::{Gaussians, SplatError};

/// A header longer than this is not one of ours.
const HEADER_MAX: usize = 64 * 1024;

/// Name and row (`None`: a normal, zero) of each property, in file order.
fn properties() -> Vec<(String, Option<usize>)> {
    let numbered = |name: &str, first: usize, count: usize| -> Vec<_> {
        (0..count).map(|i| (format!("{name}_{i}"), Some(first + i))).collect()
    };
    let mut all: Vec<_> =
        ["x", "y", "z"].iter().enumerate().map(|(i, n)| (n.to_string(), Some(POSITION + i))).collect();
    all.extend(["nx", "ny", "nz"].map(|n| (n.to_string(), None)));
    all.extend(numbered("f_dc", DC, 3));
    all.extend(numbered("f_rest", REST, 45));
    all.push(("opacity".into(), Some(OPACITY)));
    all.extend(numbered("scale", SCALE, 3));
    all.extend(numbered("rot", ROTATION, 4));
    all
}

/// The file's bytes.
pub(crate) fn encode(gaussians: &Gaussians) -> Vec<u8> {
    let properties = properties();
    let mut out = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", gaussians.len()).into_bytes();
    for (name, _) in &properties {
        out.extend(format!("property float {name}\n").bytes());
    }
    out.extend(b"end_header\n");
    for i in 0..gaussians.len() {
        let v = gaussians.vector(i);
        for (_, row) in &properties {
            out.extend(row.map_or(0.0, |r| v[r]).to_le_bytes());
        }
    }
    out
}

/// Bytes of a scalar property of the given type.
fn size_of(kind: &str) -> Option<usize> {
    Some(match kind {
        "char" | "uchar" | "int8" | "uint8" => 1,
        "short" | "ushort" | "int16" | "uint16" => 2,
        "int" | "uint" | "float" | "int32" | "uint32" | "float32" => 4,
        "double" | "float64" => 8,
        _ => return None,
    })
}

#[derive(Default)]
struct Header {
    count: usize,
    stride: usize,
    /// Name, type, offset in a vertex.
    properties: Vec<(String, String, usize)>,
    /// Where the vertices start in the file.
    body: usize,
}

fn parse_header(bytes: &[u8]) -> Result<Header, String> {
    const END: &[u8] = b"end_header\n";
    if !bytes.starts_with(b"ply\n") && !bytes.starts_with(b"ply\r\n") {
        return Err("not a PLY file: it does not begin with `ply`".into());
    }
    let window = &bytes[..bytes.len().min(HEADER_MAX)];
    let end = window.windows(END.len()).position(|w| w == END).ok_or("the header has no `end_header` line")?;
    let text = std::str::from_utf8(&window[..end]).map_err(|_| "the header is not text")?;
    let mut header = Header { body: end + END.len(), ..Header::default() };
    let mut element = false;
    let mut format = false;
    for line in text.lines().skip(1) {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["format", "binary_little_endian", _] => format = true,
            ["format", other, ..] => {
                return Err(format!("format is {other}, only binary_little_endian is read"));
            }
            ["element", "vertex", count] if !element => {
                header.count = count.parse().map_err(|_| format!("vertex count `{count}` is not a number"))?;
                element = true;
            }
            ["element", name, ..] => {
                return Err(format!("element `{name}` found, expected one element `vertex` and no other"));
            }
            ["property", "list", ..] => return Err(format!("`{line}` found, expected scalar properties only")),
            ["property", kind, name] if element => {
                let size = size_of(kind).ok_or_else(|| format!("property {name} has unknown type {kind}"))?;
                header.properties.push((name.into(), kind.into(), header.stride));
                header.stride += size;
            }
            ["comment" | "obj_info", ..] | [] => {}
            _ => return Err(format!("header line `{line}` not understood")),
        }
    }
    match (format, element) {
        (false, _) => Err("the header has no `format` line".into()),
        (_, false) => Err("the header has no `element vertex` line".into()),
        _ => Ok(header),
    }
}

/// Offset in a vertex for each of our properties that has a row.
fn locate(header: &Header) -> Result<Vec<(String, usize, usize)>, String> {
    let wanted = properties();
    let mut located = Vec::new();
    for (name, row) in wanted {
        let Some(row) = row else { continue };
        let (_, kind, offset) = header.properties.iter().find(|p| p.0 == name).ok_or_else(|| {
            format!(
                "property `{name}` is missing; expected the 3DGS layout (x … rot_3, spherical harmonics to degree 3)"
            )
        })?;
        if !matches!(kind.as_str(), "float" | "float32") {
            return Err(format!("property `{name}` has type {kind}, expected float"));
        }
        located.push((name, *offset, row));
    }
    Ok(located)
}

/// Reads what [`encode`] writes; other properties and another order are accepted.
pub(crate) fn decode(bytes: &[u8]) -> Result<Gaussians, String> {
    let header = parse_header(bytes)?;
    let located = locate(&header)?;
    let available = bytes.len() - header.body;
    // Checked before anything is allocated for the count that the file claims.
    let expected = header.count.checked_mul(header.stride).filter(|&n| n == available).ok_or_else(|| {
        format!(
            "{} vertices of {} bytes announced, found {available} bytes after the header",
            header.count, header.stride
        )
    })?;
    let body = &bytes[header.body..header.body + expected];
    let mut vectors = Vec::with_capacity(header.count);
    for (i, vertex) in body.chunks_exact(header.stride).enumerate() {
        let mut v = [0.0; PARAMETERS];
        for (name, offset, row) in &located {
            let raw = vertex[*offset..].first_chunk().ok_or("vertex shorter than its properties")?;
            v[*row] = f32::from_le_bytes(*raw);
            if !v[*row].is_finite() {
                return Err(format!("`{name}` of vertex {i} is {}, expected a finite number", v[*row]));
            }
        }
        vectors.push(v);
    }
    Ok(Gaussians::from_vectors(&vectors))
}

impl Gaussians {
    /// Reads a PLY as the original 3DGS writes it (spherical harmonics to degree 3).
    ///
    /// # Errors
    /// If the file cannot be read, is ascii or big-endian, lacks a property, has a length that
    /// disagrees with its header, or holds a value that is not finite.
    pub fn from_ply(path: &Path) -> Result<Self, SplatError> {
        let bytes = std::fs::read(path).map_err(|e| SplatError::io(path, e))?;
        decode(&bytes).map_err(|what| SplatError::ply(path, what))
    }

    /// Writes a PLY as the original 3DGS does. The file appears whole or not at all.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save_ply(&self, path: &Path) -> Result<(), SplatError> {
        let fail = |e| SplatError::io(path, e);
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut file = tempfile::NamedTempFile::new_in(folder).map_err(fail)?;
        file.write_all(&encode(self)).map_err(fail)?;
        file.as_file().sync_all().map_err(fail)?;
        share(file.as_file()).map_err(fail)?;
        file.persist(path).map_err(|e| fail(e.error))?;
        Ok(())
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    fn some() -> Gaussians {
        Gaussians::from_vectors(&[0, 1, 2].map(|i| std::array::from_fn(|r| (i * 59 + r) as f32 * 0.37 - 9.0)))
    }

    fn replaced(from: &str, to: &str) -> String {
        let bytes = encode(&some());
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
        let new = [&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat();
        decode(&new).unwrap_err()
    }

    #[test]
    fn what_is_written_is_read_back_exactly() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.ply");
        some().save_ply(&path).unwrap();
        assert_eq!(Gaussians::from_ply(&path).unwrap(), some());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn the_layout_is_the_originals() {
        let bytes = encode(&some());
        let header = parse_header(&bytes).unwrap();
        assert_eq!(header.stride, 62 * 4);
        let at = |name: &str| header.properties.iter().position(|p| p.0 == name).unwrap();
        assert_eq!(
            [at("x"), at("nx"), at("f_dc_0"), at("f_rest_0"), at("opacity"), at("scale_0"), at("rot_0")],
            [0, 3, 6, 9, 54, 55, 58]
        );
    }

    #[test]
    fn refusals_say_what_was_found() {
        for (from, to, part) in [
            ("binary_little_endian", "ascii", "format is ascii, only binary_little_endian"),
            ("binary_little_endian", "binary_big_endian", "format is binary_big_endian"),
            ("vertex 3", "vertex 4", "4 vertices of 248 bytes announced, found 744 bytes"),
            ("vertex 3", "vertex 18446744073709551615", "18446744073709551615 vertices"),
            ("vertex 3", "vertex -3", "vertex count `-3` is not a number"),
            ("float rot_3", "float nonsense", "property `rot_3` is missing"),
            ("float opacity", "double opacity", "property `opacity` has type double"),
            ("float f_rest_44", "list uchar int f_rest_44", "scalar properties only"),
            ("end_header", "end_headxr", "no `end_header`"),
            ("ply", "plz", "not a PLY file"),
        ] {
            let message = replaced(from, to);
            assert!(message.contains(part), "{message:?} should contain {part:?}");
        }
        let mut bad = some();
        bad.set(1, OPACITY, f32::NAN);
        assert_eq!(decode(&encode(&bad)).unwrap_err(), "`opacity` of vertex 1 is NaN, expected a finite number");
    }

    proptest::proptest! {
        #[test]
        fn garbage_never_panics(edits in proptest::collection::vec((0usize..2200, proptest::num::u8::ANY), 0..12), cut in 0usize..2200) {
            let mut bytes = encode(&some());
            for (at, value) in edits {
                let length = bytes.len();
                bytes[at % length] = value;
            }
            bytes.truncate(bytes.len() - cut % bytes.len());
            if let Ok(read) = decode(&bytes) {
                proptest::prop_assert!((0..read.len()).all(|i| read.vector(i).iter().all(|v| v.is_finite())));
            }
        }
    }
}
