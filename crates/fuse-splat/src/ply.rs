//! PLY files as the original 3DGS writes them: binary little endian, one `vertex` element of 62
//! floats: x, y, z, nx, ny, nz (zero), f_dc_0..2, f_rest_0..44 (15 of red, then green, then blue),
//! opacity (logit), scale_0..2 (logarithm), rot_0..3 (w first). Read are also ASCII and big endian,
//! any order of properties, other properties besides, and harmonics to a lower degree.

pub(crate) mod vertices;

use std::path::Path;

use crate::constants::{DC, OPACITY, PARAMETERS, POSITION, REST, REST_PER_CHANNEL, ROTATION, SCALE};
use crate::gaussians::logit;
use crate::{Gaussians, SplatError, files};
use vertices::Vertices;

/// What stands for an opacity of 0, and one less it for 1: they have no finite logit. Half a grey
/// level.
pub(crate) const ALPHA_EDGE: f32 = 0.5 / 255.0;

/// Name and row (`None`: a normal, zero) of each property, in file order, with `rest` harmonics
/// beyond the constant one for each colour.
fn properties(rest: usize) -> Vec<(String, Option<usize>)> {
    let numbered = |name: &str, first: usize, count: usize| -> Vec<_> {
        (0..count).map(|i| (format!("{name}_{i}"), Some(first + i))).collect()
    };
    let mut all: Vec<_> =
        ["x", "y", "z"].iter().enumerate().map(|(i, n)| (n.to_string(), Some(POSITION + i))).collect();
    all.extend(["nx", "ny", "nz"].map(|n| (n.to_string(), None)));
    all.extend(numbered("f_dc", DC, 3));
    for channel in 0..3 {
        let name = |k| format!("f_rest_{}", channel * rest + k);
        all.extend((0..rest).map(|k| (name(k), Some(REST + channel * REST_PER_CHANNEL + k))));
    }
    all.push(("opacity".into(), Some(OPACITY)));
    all.extend(numbered("scale", SCALE, 3));
    all.extend(numbered("rot", ROTATION, 4));
    all
}

/// The file's bytes.
pub(crate) fn encode(gaussians: &Gaussians) -> Vec<u8> {
    let properties = properties(REST_PER_CHANNEL);
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

/// Reads what [`encode`] writes, and its relatives.
pub(crate) fn decode(bytes: &[u8]) -> Result<Gaussians, String> {
    let vertices = Vertices::parse(bytes)?;
    let rest = match vertices.numbered("f_rest_") {
        n @ (0 | 9 | 24) => n / 3,
        // A file without harmonics at all is told so below, by the first that is missing.
        45 => REST_PER_CHANNEL,
        n => return Err(format!("{n} properties `f_rest_…` found, expected 45, 24, 9 or none (degree 3 to 0)")),
    };
    let (names, rows): (Vec<_>, Vec<_>) =
        properties(rest).into_iter().filter_map(|(name, row)| row.map(|r| (name, r))).unzip();
    // Converters from formats of 8 bits write an infinite logit for an opacity of 0 or 1.
    let read =
        vertices.read(&names, "opacity", "the 3DGS layout (x, y, z, f_dc_0 … 2, f_rest_…, opacity, scale_…, rot_…)")?;
    if read.is_empty() {
        return Err("the file has no vertices, expected at least one Gaussian".into());
    }
    let vector = |values: &Vec<f32>| {
        let mut v = [0.0; PARAMETERS];
        for (row, value) in rows.iter().zip(values) {
            v[*row] = *value;
        }
        if v[OPACITY].is_infinite() {
            v[OPACITY] = logit(ALPHA_EDGE).copysign(v[OPACITY]);
        }
        v
    };
    Ok(Gaussians::from_vectors(&read.iter().map(vector).collect::<Vec<_>>()))
}

impl Gaussians {
    /// Reads a PLY as the original 3DGS writes it (spherical harmonics to degree 3 or less).
    ///
    /// # Errors
    /// If the file cannot be read, has no vertices, lacks a property, has a length that disagrees
    /// with its header, or holds a value that is not finite.
    pub fn from_ply(path: &Path) -> Result<Self, SplatError> {
        decode(&files::read(path)?).map_err(|what| SplatError::file(path, what))
    }

    /// Writes a PLY as the original 3DGS does. The file appears whole or not at all.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save_ply(&self, path: &Path) -> Result<(), SplatError> {
        files::write(path, &[&encode(self)])
    }
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
        assert_eq!(Vertices::parse(&bytes).unwrap().stride, 62 * 4);
        let all = properties(REST_PER_CHANNEL);
        let at = |name: &str| all.iter().position(|p| p.0 == name).unwrap();
        assert_eq!(
            [at("x"), at("nx"), at("f_dc_0"), at("f_rest_0"), at("opacity"), at("scale_0"), at("rot_0")],
            [0, 3, 6, 9, 54, 55, 58]
        );
    }

    #[test]
    fn refusals_say_what_was_found() {
        for (from, to, part) in [
            ("binary_little_endian", "ascii", "the vertices are not text"),
            ("binary_little_endian", "binary_pdp_endian", "format `binary_pdp_endian` unknown"),
            ("vertex 3", "vertex 0", "0 vertices of 248 bytes announced"),
            ("vertex 3", "vertex 1000000000", "1000000000 vertices of 248 bytes announced, found 744 bytes"),
            ("vertex 3", "vertex 4", "4 vertices of 248 bytes announced, found 744 bytes"),
            ("vertex 3", "vertex 18446744073709551615", "18446744073709551615 vertices"),
            ("vertex 3", "vertex -3", "vertex count `-3` is not a whole number"),
            ("float rot_3", "float nonsense", "property `rot_3` is missing"),
            ("float opacity", "double opacity", "3 vertices of 252 bytes announced"),
            ("float f_rest_44", "float x", "property `x` is there twice"),
            ("float f_rest_44", "float f_best_44", "44 properties `f_rest_…` found, expected 45, 24, 9 or none"),
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

    #[test]
    fn opacities_of_zero_and_one_are_read() {
        let mut g = some();
        g.set(0, OPACITY, f32::INFINITY);
        g.set(1, OPACITY, f32::NEG_INFINITY);
        let read = decode(&encode(&g)).unwrap();
        assert!((read.opacity(0) - 1.0).abs() < 0.01 && read.opacity(1) < 0.01);
        g.set(2, OPACITY + 1, f32::INFINITY);
        assert!(decode(&encode(&g)).unwrap_err().contains("`f_dc_0` of vertex 2 is inf"));
    }

    #[test]
    fn other_forms_of_the_same_file() {
        let mut flat = some();
        for i in 0..3 {
            for row in REST..PARAMETERS {
                // Degree 1: the first three of fifteen harmonics a colour.
                if (row - REST) % REST_PER_CHANNEL >= 3 {
                    flat.set(i, row, 0.0);
                }
            }
        }
        let properties = properties(3);
        let header = |format: &str, count: usize| {
            let mut h = format!("ply\r\nformat {format} 1.0\r\ncomment made by hand\r\nelement vertex {count}\r\n");
            for (name, _) in &properties {
                h.push_str(&format!("property float {name}\r\n"));
            }
            h + "end_header\r\n"
        };
        let values: Vec<f32> = (0..3)
            .flat_map(|i| properties.iter().map(move |p| (i, p.1)))
            .map(|(i, r)| r.map_or(0.0, |r| flat.table.get(i, r)))
            .collect();
        let mut big = header("binary_big_endian", 3).into_bytes();
        big.extend(values.iter().flat_map(|v| v.to_be_bytes()));
        assert_eq!(decode(&big).unwrap(), flat);
        let words: Vec<String> = values.iter().map(|v| v.to_string()).collect();
        let text = header("ascii", 3) + &words.join(" ");
        assert_eq!(decode(text.as_bytes()).unwrap(), flat);
        for (text, part) in [
            (header("ascii", 3) + &words[1..].join(" "), "the text ends within vertex 2 of 3"),
            (header("ascii", 3) + &words.join(" ") + " 7", "`7` follows the last of 3 vertices"),
            (header("ascii", 3) + "x" + &words.join(" "), "`x` of vertex 0 is `x-9`, expected a number"),
            (header("ascii", 1_000_000_000), "1000000000 vertices of 26 properties announced, found 0 bytes"),
            (header("ascii", 0), "the file has no vertices"),
        ] {
            let message = decode(text.as_bytes()).unwrap_err();
            assert!(message.contains(part), "{message:?} should contain {part:?}");
        }
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
