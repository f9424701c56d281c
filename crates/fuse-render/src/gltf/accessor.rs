//! Numbers out of buffers: every component type, normalised or not, strided, sparse.

use gltf::accessor::sparse::IndexType;
use gltf::accessor::{DataType, Dimensions};
use gltf::{Accessor, buffer};

/// The bytes of a buffer view.
pub fn view_bytes<'a>(buffers: &'a [Vec<u8>], view: &buffer::View<'_>) -> Result<&'a [u8], String> {
    let buffer = buffers.get(view.buffer().index()).map_or(&[][..], Vec::as_slice);
    let end = view.offset().checked_add(view.length());
    end.and_then(|end| buffer.get(view.offset()..end))
        .ok_or_else(|| format!("buffer view {} reaches beyond its buffer of {} bytes", view.index(), buffer.len()))
}

/// `count` elements of `size` bytes, `stride` apart, from `offset` on.
fn elements<'a>(
    data: &'a [u8],
    [offset, count, size, stride]: [usize; 4],
    what: &str,
) -> Result<impl Iterator<Item = &'a [u8]> + use<'a>, String> {
    let last = count.checked_sub(1).and_then(|n| n.checked_mul(stride)?.checked_add(offset)?.checked_add(size));
    let fits = count == 0 || (stride >= size && last.is_some_and(|last| last <= data.len()));
    if !fits {
        return Err(format!(
            "{what} reaches beyond its buffer view of {} bytes: {count} elements of {size} bytes, {stride} apart, from \
             byte {offset}",
            data.len()
        ));
    }
    Ok((0..count).map(move |i| &data[offset + i * stride..offset + i * stride + size]))
}

/// The bytes of every element, one after another; sparse ones put in.
fn packed(buffers: &[Vec<u8>], accessor: &Accessor<'_>) -> Result<Vec<u8>, String> {
    let what = format!("accessor {}", accessor.index());
    let (size, count) = (accessor.size(), accessor.count());
    let Some(view) = accessor.view() else {
        let sparse = if accessor.sparse().is_some() { " (sparse over nothing, which is not supported)" } else { "" };
        return Err(format!("{what} has no data{sparse}"));
    };
    let base = view_bytes(buffers, &view)?;
    let stride = view.stride().unwrap_or(size);
    let mut out: Vec<u8> =
        elements(base, [accessor.offset(), count, size, stride], &what)?.flatten().copied().collect();
    if let Some(sparse) = accessor.sparse() {
        let (indices, values) = (sparse.indices(), sparse.values());
        let width = match indices.index_type() {
            IndexType::U8 => 1,
            IndexType::U16 => 2,
            IndexType::U32 => 4,
        };
        let at = view_bytes(buffers, &indices.view())?;
        let at = elements(at, [indices.offset(), sparse.count(), width, width], &format!("{what}'s sparse indices"))?;
        let new = view_bytes(buffers, &values.view())?;
        let new = elements(new, [values.offset(), sparse.count(), size, size], &format!("{what}'s sparse values"))?;
        for (i, value) in at.zip(new) {
            let i = little_endian(i) as usize;
            let place = out.get_mut(i.saturating_mul(size)..i.saturating_add(1).saturating_mul(size));
            place.ok_or_else(|| format!("{what} replaces element {i}, but there are {count}"))?.copy_from_slice(value);
        }
    }
    Ok(out)
}

fn little_endian(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |v, b| v << 8 | u64::from(*b))
}

/// Vectors of `N` numbers; integers as they are, or divided by their largest where the accessor is
/// normalised.
pub fn vectors<const N: usize>(
    buffers: &[Vec<u8>],
    accessor: &Accessor<'_>,
    what: &str,
) -> Result<Vec<[f32; N]>, String> {
    let width = match accessor.dimensions() {
        Dimensions::Vec2 => 2,
        Dimensions::Vec3 => 3,
        Dimensions::Vec4 => 4,
        _ => 0,
    };
    let kind = accessor.data_type();
    if width != N || kind == DataType::U32 {
        let i = accessor.index();
        return Err(format!(
            "{what} (accessor {i}) are {kind:?} {:?}, expected Vec{N} of floats or of 8- or 16-bit integers",
            accessor.dimensions()
        ));
    }
    let scale = if accessor.normalized() { 1.0 } else { 0.0 };
    let component = |b: &[u8]| -> f32 {
        let bits = little_endian(b);
        let (value, most) = match kind {
            DataType::F32 => return f32::from_bits(bits as u32),
            DataType::I8 => (f32::from(bits as u8 as i8), 127.0),
            DataType::U8 => (f32::from(bits as u8), 255.0),
            DataType::I16 => (f32::from(bits as u16 as i16), 32767.0),
            DataType::U16 | DataType::U32 => (f32::from(bits as u16), 65535.0),
        };
        if scale > 0.0 { (value / most).max(-1.0) } else { value }
    };
    let bytes = packed(buffers, accessor)?;
    let each = kind.size();
    // Three 8-bit components fill 3 of an element's bytes; `size` counts just those.
    Ok(bytes.chunks_exact(N * each).map(|e| std::array::from_fn(|k| component(&e[k * each..(k + 1) * each]))).collect())
}

/// Vertex indices.
pub fn indices(buffers: &[Vec<u8>], accessor: &Accessor<'_>) -> Result<Vec<u32>, String> {
    let kind = accessor.data_type();
    if accessor.dimensions() != Dimensions::Scalar || !matches!(kind, DataType::U8 | DataType::U16 | DataType::U32) {
        let i = accessor.index();
        return Err(format!(
            "indices (accessor {i}) are {kind:?} {:?}, expected unsigned Scalar",
            accessor.dimensions()
        ));
    }
    let bytes = packed(buffers, accessor)?;
    Ok(bytes.chunks_exact(kind.size()).map(|b| little_endian(b) as u32).collect())
}
