//! SPZ files (Niantic Labs, `nianticlabs/spz`): a gzip stream of a 16-byte header, then for all
//! Gaussians positions (24-bit fixed point), opacities, colours, scales, rotations and harmonics, a
//! byte or so a number. Versions 2 and 3 are read, 3 is written.
//!
//! Axes: SPZ is right-up-back, PLY right-down-front, so that y and z change sign between them, as
//! in Niantic's own converter.

use std::io::Read as _;
use std::path::Path;

use flate2::Compression;
use flate2::read::{GzDecoder, GzEncoder};

use crate::constants::{DC, OPACITY, PARAMETERS, POSITION, REST, REST_PER_CHANNEL, ROTATION, SCALE};
use crate::gaussians::logit;
use crate::ply::ALPHA_EDGE;
use crate::{Gaussians, SplatError, files};

const MAGIC: u32 = 0x5053_474e;
const HEADER: usize = 16;
const VERSION: u32 = 3;
/// Vendors' extensions follow the Gaussians; they are skipped.
const FLAG_EXTENSIONS: u8 = 2;
/// Bits behind the point that are written: a quarter of a millimetre.
const FRACTION_BITS: u32 = 12;
/// One of a position's 24-bit numbers is at most this.
const FIXED_MAX: f32 = 8_388_607.0;
/// Grey levels of a byte for one unit of the constant harmonic.
const COLOR_SCALE: f32 = 0.15 * 255.0;
/// Deflate never shrinks by more than about 1032; a larger promise is false.
const RATIO_MAX: u64 = 1100;

/// Signs of the harmonics beyond the constant one when y and z change theirs.
const SH_SIGNS: [f32; REST_PER_CHANNEL] =
    [-1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0];
/// The same for positions and for the vector part of quaternions.
const SIGNS: [f32; 3] = [1.0, -1.0, -1.0];

/// Harmonics beyond the constant one, per colour, at a degree.
fn harmonics(degree: u8) -> Option<usize> {
    [0, 3, 8, 15, 24].get(usize::from(degree)).copied()
}

struct Header {
    version: u32,
    count: usize,
    /// Per colour.
    rest: usize,
    fraction_bits: u32,
    flags: u8,
}

impl Header {
    fn parse(b: &[u8; HEADER]) -> Result<Self, String> {
        let word = |i: usize| u32::from_le_bytes([b[i], b[i + 1], b[i + 2], b[i + 3]]);
        if word(0) != MAGIC {
            return Err("not an SPZ file: it does not begin with `NGSP`".into());
        }
        let version = word(4);
        if version != 2 && version != 3 {
            return Err(format!("SPZ version {version} found, versions 2 and 3 are read"));
        }
        let rest = harmonics(b[12]).ok_or_else(|| format!("harmonics of degree {} found, expected 0 to 4", b[12]))?;
        if b[13] > 23 {
            return Err(format!("{} bits behind the point found, expected at most 23", b[13]));
        }
        let count = usize::try_from(word(8)).map_err(|_| "more Gaussians than this machine can address")?;
        Ok(Self { version, count, rest, fraction_bits: u32::from(b[13]), flags: b[14] })
    }

    fn rotation_bytes(&self) -> usize {
        if self.version >= 3 { 4 } else { 3 }
    }

    /// Bytes of all Gaussians.
    fn size(&self) -> u64 {
        self.count as u64 * (9 + 1 + 3 + 3 + self.rotation_bytes() + 3 * self.rest) as u64
    }
}

/// Reads what Niantic's library and its relatives write.
pub(crate) fn decode(bytes: &[u8]) -> Result<Gaussians, String> {
    if bytes.starts_with(&MAGIC.to_le_bytes()) {
        return Err("an SPZ file of version 4 or later, versions 2 and 3 (gzip) are read".into());
    }
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return Err("not an SPZ file: it is not compressed with gzip".into());
    }
    let mut stream = GzDecoder::new(bytes);
    let mut head = [0; HEADER];
    stream.read_exact(&mut head).map_err(|e| format!("truncated or broken within the header: {e}"))?;
    let header = Header::parse(&head)?;
    let size = header.size();
    if size > RATIO_MAX * bytes.len() as u64 {
        return Err(format!("{} Gaussians announced in a file of {} bytes", header.count, bytes.len()));
    }
    if header.count == 0 {
        return Err("the file has no Gaussians, expected at least one".into());
    }
    let mut body = Vec::new();
    stream.by_ref().take(size).read_to_end(&mut body).map_err(|e| format!("truncated or broken: {e}"))?;
    if (body.len() as u64) < size {
        return Err(format!(
            "truncated: {} Gaussians take {size} bytes, found {} bytes after the header",
            header.count,
            body.len()
        ));
    }
    let mut beyond = [0];
    let more = stream.read(&mut beyond).map_err(|e| format!("truncated or broken at its end: {e}"))?;
    if more > 0 && header.flags & FLAG_EXTENSIONS == 0 {
        return Err(format!("more bytes follow than {} Gaussians take", header.count));
    }
    Ok(Gaussians::from_vectors(&unpack(&header, &body)))
}

fn unpack(header: &Header, body: &[u8]) -> Vec<[f32; PARAMETERS]> {
    let n = header.count;
    let (positions, rest) = body.split_at(9 * n);
    let (alphas, rest) = rest.split_at(n);
    let (colors, rest) = rest.split_at(3 * n);
    let (scales, rest) = rest.split_at(3 * n);
    let (rotations, sh) = rest.split_at(header.rotation_bytes() * n);
    let unit = 1.0 / (1u32 << header.fraction_bits) as f32;
    // Degree 4 is more than the model has: its last nine harmonics are left out.
    let kept = header.rest.min(REST_PER_CHANNEL);
    (0..n)
        .map(|i| {
            let mut v = [0.0; PARAMETERS];
            for k in 0..3 {
                let b = &positions[9 * i + 3 * k..];
                // The sign is that of the top bit: shifted to the top of 32, and back.
                let fixed = i32::from_le_bytes([0, b[0], b[1], b[2]]) >> 8;
                v[POSITION + k] = SIGNS[k] * fixed as f32 * unit;
                v[SCALE + k] = f32::from(scales[3 * i + k]) / 16.0 - 10.0;
                v[DC + k] = (f32::from(colors[3 * i + k]) - 127.5) / COLOR_SCALE;
            }
            v[OPACITY] = logit((f32::from(alphas[i]) / 255.0).clamp(ALPHA_EDGE, 1.0 - ALPHA_EDGE));
            let [x, y, z, w] = match header.version {
                2 => first_three(&rotations[3 * i..]),
                _ => smallest_three(&rotations[4 * i..]),
            };
            v[ROTATION..ROTATION + 4].copy_from_slice(&[w, SIGNS[0] * x, SIGNS[1] * y, SIGNS[2] * z]);
            for k in 0..kept {
                for c in 0..3 {
                    let byte = sh[3 * (header.rest * i + k) + c];
                    v[REST + REST_PER_CHANNEL * c + k] = SH_SIGNS[k] * (f32::from(byte) - 128.0) / 128.0;
                }
            }
            v
        })
        .collect()
}

/// Version 2: x, y, z in a byte each; w ≥ 0 follows from the length.
fn first_three(b: &[u8]) -> [f32; 4] {
    let [x, y, z] = [b[0], b[1], b[2]].map(|v| f32::from(v) / 127.5 - 1.0);
    [x, y, z, (1.0 - x * x - y * y - z * z).max(0.0).sqrt()]
}

/// Version 3: two bits say which of x, y, z, w is largest, and is left out; the others follow in
/// order, the last in the lowest bits: a sign, and nine bits of |q| √2.
fn smallest_three(b: &[u8]) -> [f32; 4] {
    let mut word = u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    let largest = (word >> 30) as usize;
    let mut q = [0.0f32; 4];
    for k in (0..4).rev().filter(|&k| k != largest) {
        let magnitude = (word & 511) as f32 / 511.0 * std::f32::consts::FRAC_1_SQRT_2;
        q[k] = if word >> 9 & 1 == 1 { -magnitude } else { magnitude };
        word >>= 10;
    }
    q[largest] = (1.0 - q.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
    q
}

fn pack_smallest_three(q: [f32; 4]) -> [u8; 4] {
    let largest = (0..4).max_by(|&a, &b| q[a].abs().total_cmp(&q[b].abs())).unwrap_or(0);
    let flip = q[largest] < 0.0;
    let mut word = largest as u32;
    for k in (0..4).filter(|&k| k != largest) {
        let magnitude = (511.0 * q[k].abs() * std::f32::consts::SQRT_2 + 0.5) as u32;
        word = word << 10 | u32::from((q[k] < 0.0) != flip) << 9 | magnitude.min(511);
    }
    word.to_le_bytes()
}

fn byte(v: f32) -> u8 {
    v.round().clamp(0.0, 255.0) as u8
}

/// Harmonics keep 5 bits at degree 1 and 4 above, as Niantic's library does by default: what is
/// left out compresses away.
fn pack_harmonic(v: f32, k: usize) -> u8 {
    let bucket = if k < 3 { 8 } else { 16 };
    let q = (v * 128.0).round().clamp(-1024.0, 1024.0) as i32 + 128;
    // Rounds towards zero, as C does.
    ((q + bucket / 2) / bucket * bucket).clamp(0, 255) as u8
}

/// The bytes before compression.
fn pack(gaussians: &Gaussians) -> Result<Vec<u8>, String> {
    let n = gaussians.len();
    let count = u32::try_from(n).map_err(|_| format!("{n} Gaussians are more than SPZ holds"))?;
    let largest = (0..n).flat_map(|i| gaussians.position(i)).fold(0.0f32, |m, v| m.max(v.abs()));
    // Large scenes give up resolution rather than wrap around.
    let bits = (0..=FRACTION_BITS).rev().find(|&b| largest * (1u32 << b) as f32 <= FIXED_MAX);
    let bits = bits.ok_or_else(|| format!("a position of {largest} is beyond SPZ's range of ±{FIXED_MAX}"))?;
    let mut out = Vec::with_capacity(HEADER + 65 * n);
    for word in [MAGIC, VERSION, count] {
        out.extend(word.to_le_bytes());
    }
    out.extend([3, bits as u8, 0, 0]);
    for i in 0..n {
        for (sign, v) in SIGNS.iter().zip(gaussians.position(i)) {
            let fixed = (sign * v * (1u32 << bits) as f32).round() as i32;
            out.extend(&fixed.to_le_bytes()[..3]);
        }
    }
    out.extend((0..n).map(|i| byte(255.0 * gaussians.opacity(i))));
    let table = gaussians.table();
    let rows = |first: usize| (0..n).flat_map(move |i| table.rows::<3>(i, first));
    out.extend(rows(DC).map(|v| byte(v * COLOR_SCALE + 127.5)));
    out.extend(rows(SCALE).map(|v| byte((v + 10.0) * 16.0)));
    for i in 0..n {
        let [w, x, y, z] = table.rows::<4>(i, ROTATION);
        let length = (w * w + x * x + y * y + z * z).sqrt();
        let unit = if length > 0.0 { [x, y, z, w].map(|v| v / length) } else { [0.0, 0.0, 0.0, 1.0] };
        out.extend(pack_smallest_three([SIGNS[0] * unit[0], SIGNS[1] * unit[1], SIGNS[2] * unit[2], unit[3]]));
    }
    for i in 0..n {
        for k in 0..REST_PER_CHANNEL {
            for c in 0..3 {
                out.push(pack_harmonic(SH_SIGNS[k] * table.get(i, REST + REST_PER_CHANNEL * c + k), k));
            }
        }
    }
    Ok(out)
}

/// The file's bytes.
pub(crate) fn encode(gaussians: &Gaussians) -> Result<Vec<u8>, String> {
    let packed = pack(gaussians)?;
    let mut out = Vec::new();
    GzEncoder::new(packed.as_slice(), Compression::default()).read_to_end(&mut out).map_err(|e| e.to_string())?;
    Ok(out)
}

impl Gaussians {
    /// Reads an SPZ file (versions 2 and 3).
    ///
    /// # Errors
    /// If the file cannot be read, is of another version, truncated, or without Gaussians.
    pub fn from_spz(path: &Path) -> Result<Self, SplatError> {
        decode(&files::read(path)?).map_err(|what| SplatError::file(path, what))
    }

    /// Writes an SPZ file (version 3): about a tenth of the PLY, slightly coarser. The file appears
    /// whole or not at all.
    ///
    /// # Errors
    /// If the file cannot be written, or a position is beyond ±8,388,607.
    pub fn save_spz(&self, path: &Path) -> Result<(), SplatError> {
        let bytes = encode(self).map_err(|what| SplatError::file(path, what))?;
        files::write(path, &[&bytes])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some() -> Gaussians {
        let mut state = 3u32;
        let mut random = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        let vectors: Vec<_> = (0..50)
            .map(|_| {
                let mut v: [f32; PARAMETERS] = std::array::from_fn(|_| 0.9 * random());
                for s in &mut v[SCALE..SCALE + 3] {
                    *s = 3.0 * *s - 4.0;
                }
                v[OPACITY] *= 4.0;
                v
            })
            .collect();
        Gaussians::from_vectors(&vectors)
    }

    #[test]
    fn what_is_written_is_read_back_within_the_formats_steps() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.spz");
        some().save_spz(&path).unwrap();
        let (read, truth) = (Gaussians::from_spz(&path).unwrap(), some());
        assert_eq!(read.len(), truth.len());
        for i in 0..truth.len() {
            let (a, b) = (read.vector(i), truth.vector(i));
            let worst =
                |first: usize, count: usize| (first..first + count).map(|r| (a[r] - b[r]).abs()).fold(0.0f32, f32::max);
            assert!(worst(POSITION, 3) <= 0.5 / 4096.0 + 1e-7);
            assert!(worst(SCALE, 3) <= 1.0 / 32.0 + 1e-6);
            assert!(worst(DC, 3) <= 0.5 / COLOR_SCALE + 1e-6);
            assert!(worst(REST, 45) <= 0.5 / 128.0 + 8.0 / 128.0 + 1e-6);
            assert!((read.opacity(i) - truth.opacity(i)).abs() <= 0.5 / 255.0 + 1e-6);
            let dot: f32 = (0..4).map(|k| a[ROTATION + k] * b[ROTATION + k]).sum();
            let length: f32 = (0..4).map(|k| b[ROTATION + k].powi(2)).sum::<f32>().sqrt();
            assert!(dot.abs() / length > 0.99999, "{dot} of {length}");
        }
    }

    #[test]
    fn large_scenes_lose_resolution_and_huge_ones_are_refused() {
        let mut g = some();
        g.set(0, POSITION, 5000.0);
        let read = decode(&encode(&g).unwrap()).unwrap();
        assert!((read.position(0)[0] - 5000.0).abs() < 1e-2);
        g.set(0, POSITION, 9e6);
        assert!(encode(&g).unwrap_err().contains("a position of 9000000 is beyond"));
    }

    #[test]
    fn refusals_say_what_was_found() {
        let gzip = |b: &[u8]| {
            let mut out = Vec::new();
            GzEncoder::new(b, Compression::default()).read_to_end(&mut out).unwrap();
            out
        };
        let packed = pack(&some()).unwrap();
        let with = |at: usize, value: u8| {
            let mut b = packed.clone();
            b[at] = value;
            gzip(&b)
        };
        let whole = gzip(&packed);
        for (bytes, part) in [
            (with(0, b'x'), "does not begin with `NGSP`"),
            (with(4, 1), "SPZ version 1 found"),
            (with(12, 5), "harmonics of degree 5"),
            (with(13, 24), "24 bits behind the point"),
            (with(8, 51), "truncated: 51 Gaussians take"),
            (with(8, 49), "more bytes follow than 49 Gaussians take"),
            (with(11, 200), "Gaussians announced in a file of"),
            (gzip(&[packed[..8].to_vec(), vec![0; 8]].concat()), "no Gaussians"),
            (packed.clone(), "version 4 or later"),
            (b"ply".to_vec(), "not compressed with gzip"),
            (whole[..whole.len() / 2].to_vec(), "truncated"),
            (whole[..14].to_vec(), "truncated"),
            (whole[..whole.len() - 3].to_vec(), "truncated or broken at its end"),
        ] {
            let message = decode(&bytes).unwrap_err();
            assert!(message.contains(part), "{message:?} should contain {part:?}");
        }
    }
}
