//! Model files: what goes in comes out, foreign files load, damaged ones are refused.

mod common;

use std::path::Path;
use std::sync::Arc;

use common::{checker, cuboid, material, merge, sphere, textured};
use fuse_render::{Model, ModelError, from_glb, load, save_glb, to_glb};
use glam::Vec3;
use proptest::prelude::*;

fn sample() -> Model {
    let mut part = sphere(0.05, 12);
    part.material = 1;
    let mut paint = textured(checker(4.0), 0.4);
    paint.name = "paint \"red\" \\ 1".into();
    paint.double_sided = true;
    Model {
        meshes: vec![cuboid(Vec3::new(0.1, 0.2, 0.3)), part],
        materials: vec![paint, material([0.9, 0.7, 0.3], 1.0, 0.25)],
    }
}

/// A minimal glTF whose parts can be replaced.
fn gltf_json(buffer: &str, extra: &str) -> String {
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,1]}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}}],"buffers":[{{"byteLength":36{buffer}}}]{extra}}}"#
    )
}

fn reason(bytes: &[u8]) -> String {
    match from_glb(bytes, "cup.glb") {
        Ok(_) => "accepted".into(),
        Err(e) => e.to_string(),
    }
}

fn glb(json: &str, binary: &[u8]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend((28 + json.len() as u32 + binary.len() as u32).to_le_bytes());
    out.extend((json.len() as u32).to_le_bytes());
    out.extend(b"JSON");
    out.extend(&json);
    out.extend((binary.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(binary);
    out
}

#[test]
fn a_saved_model_comes_back() {
    let model = sample();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("thing.glb");
    save_glb(&model, &path).unwrap();
    let back = load(&path).unwrap();
    for (a, b) in back.meshes.iter().zip(&model.meshes) {
        assert_eq!((&a.positions, &a.uvs, &a.triangles, a.material), (&b.positions, &b.uvs, &b.triangles, b.material));
        assert!(a.normals.iter().zip(&b.normals).all(|(a, b)| (a - b).length() < 1e-6));
    }
    assert_eq!(back.materials.len(), 2);
    for (a, b) in back.materials.iter().zip(&model.materials) {
        assert_eq!((&a.name, a.base_color, a.metallic, a.roughness), (&b.name, b.base_color, b.metallic, b.roughness));
        assert_eq!(a.double_sided, b.double_sided);
    }
    let (old, new) = (&model.materials[0].base_color_texture, &back.materials[0].base_color_texture);
    assert_eq!(old.as_ref().unwrap().texels, new.as_ref().unwrap().texels, "a small flat texture is stored exactly");
    assert_eq!(to_glb(&model), std::fs::read(&path).unwrap(), "the same model gives the same bytes");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no partial file is left");
}

#[test]
fn noisy_textures_are_stored_as_jpeg_close_to_the_original() {
    let mut model = sample();
    let texture = Arc::new(common::wood());
    model.materials[0].base_color_texture = Some(texture.clone());
    let bytes = to_glb(&model);
    assert!(bytes.len() < texture.texels.len(), "{} bytes for {} texels", bytes.len(), texture.texels.len());
    let back = from_glb(&bytes, "wood").unwrap();
    let back = back.materials[0].base_color_texture.as_ref().unwrap();
    let difference = |(a, b): (&[u8; 4], &[u8; 4])| (0..3).map(|c| a[c].abs_diff(b[c]) as u64).sum::<u64>();
    let total: u64 = texture.texels.iter().zip(&back.texels).map(difference).sum();
    let mean = total as f64 / (3 * texture.texels.len()) as f64;
    assert!(mean < 4.0, "mean difference {mean}");
}

#[test]
fn a_file_from_trimesh_loads_with_its_node_transform_and_axes() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/trimesh_box.glb");
    let model = load(path).unwrap();
    let (lo, hi) = model.bounds().unwrap();
    // y up: a 0.2 x 0.3 x 0.4 box turned by 90° about y at (1, 2, 3); z up: (x, -z, y).
    assert!((lo - Vec3::new(0.8, -3.1, 1.85)).length() < 1e-5, "{lo}");
    assert!((hi - Vec3::new(1.2, -2.9, 2.15)).length() < 1e-5, "{hi}");
    assert_eq!(model.triangle_count(), 12);
    let m = &model.materials[0];
    assert_eq!((m.metallic, m.roughness, m.double_sided), (0.25, 0.5, true));
    let texture = m.base_color_texture.as_ref().unwrap();
    assert_eq!((texture.width, texture.texels[0], texture.texels[15]), (4, [255, 0, 0, 255], [255; 4]));
    let center = (lo + hi) * 0.5;
    let mesh = &model.meshes[0];
    for t in &mesh.triangles {
        let p = t.map(|i| mesh.positions[i as usize]);
        let outward = (p[1] - p[0]).cross(p[2] - p[0]).dot((p[0] + p[1] + p[2]) / 3.0 - center);
        assert!(outward > 0.0, "triangles keep their outside");
        assert!(t.iter().all(|&i| mesh.normals[i as usize].dot(mesh.positions[i as usize] - center) > 0.0));
    }
}

#[test]
fn obj_files_load_with_material_and_texture() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("a.mtl", "newmtl red\nKd 0.5 0.25 0.125\nNs 30\n");
    write(
        "a.obj",
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl red\nf 1/1 2/2 3/3 4/4\n",
    );
    let model = load(folder.path().join("a.obj")).unwrap();
    assert_eq!(model.triangle_count(), 2);
    assert_eq!(model.materials[0].base_color, [0.5, 0.25, 0.125, 1.0]);
    assert!(model.meshes[0].normals.iter().all(|n| (*n - Vec3::Z).length() < 1e-6));
    assert_eq!(model.meshes[0].uvs[0].y, 1.0, "v runs downwards");
    write("b.obj", "mtllib ../a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n");
    let message = load(folder.path().join("b.obj")).unwrap_err().to_string();
    assert!(message.contains("only files in its own folder"), "{message}");
    write("c.obj", "v 0 0 0\n");
    let message = load(folder.path().join("c.obj")).unwrap_err().to_string();
    assert!(message.contains("no triangles"), "{message}");
    write("d.obj", "v 0 0 0\nv 1 0 0\nv 1 nan 0\nf 1 2 3\n");
    let message = load(folder.path().join("d.obj")).unwrap_err().to_string();
    assert!(message.contains("not finite") || message.contains("not a sound OBJ"), "{message}");
}

#[test]
fn refusals_name_the_file_and_the_cause() {
    let missing = load("nowhere/cup.glb").unwrap_err();
    assert!(matches!(missing, ModelError::Io { .. }) && missing.to_string().contains("nowhere/cup.glb"));
    assert!(load("cup.stl").unwrap_err().to_string().contains(".glb, .gltf or .obj"));
    let good = to_glb(&sample());
    let triangle: Vec<u8> = [0f32, 0., 0., 1., 0., 0., 0., 1., 0.].iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(reason(&glb(&gltf_json("", ""), &triangle)), "accepted");
    let mut nan = triangle.clone();
    nan[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
    let draco =
        r#","extensionsRequired":["KHR_draco_mesh_compression"],"extensionsUsed":["KHR_draco_mesh_compression"]"#;
    let no_triangles = gltf_json("", "").replace(r#""attributes""#, r#""mode":1,"attributes""#);
    let beyond = gltf_json("", "").replace(r#""count":3"#, r#""count":4"#);
    let outside = gltf_json(r#","uri":"../../secret.bin""#, "");
    for (bytes, expected) in [
        (good[..good.len() / 2].to_vec(), "truncated"),
        (good[..7].to_vec(), "truncated"),
        (Vec::new(), "empty"),
        (b"hello".to_vec(), "not glTF"),
        (glb(&gltf_json("", ""), &nan), "not finite"),
        (glb(&gltf_json("", draco), &triangle), "KHR_draco_mesh_compression"),
        (glb(&no_triangles, &triangle), "no triangles"),
        (glb(&beyond, &triangle), "reaches beyond"),
        (glb(&outside, &[]), "only its own bytes"),
    ] {
        let message = reason(&bytes);
        assert!(message.contains(expected) && message.contains("cup.glb"), "{message:?} for {expected:?}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cup.gltf");
    std::fs::write(&path, outside).unwrap();
    let message = load(&path).unwrap_err().to_string();
    assert!(message.contains("only files in its own folder") && message.contains("cup.gltf"), "{message}");
}

#[test]
fn a_huge_texture_is_refused_before_it_is_decoded() {
    // A PNG header that claims 100000 x 100000 pixels.
    let mut header = b"IHDR".to_vec();
    header.extend(100_000u32.to_be_bytes());
    header.extend(100_000u32.to_be_bytes());
    header.extend([8, 2, 0, 0, 0]);
    let crc = header.iter().fold(!0u32, |crc, &b| {
        (0..8).fold(crc ^ u32::from(b), |c, _| if c & 1 == 1 { (c >> 1) ^ 0xedb8_8320 } else { c >> 1 })
    });
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0d".to_vec();
    png.extend(&header);
    png.extend((!crc).to_be_bytes());
    png.extend(b"\0\0\0\0IDAT\0\0\0\0");
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("big.png"), &png).unwrap();
    std::fs::write(folder.path().join("m.mtl"), "newmtl a\nmap_Kd big.png\n").unwrap();
    std::fs::write(folder.path().join("m.obj"), "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl a\nf 1 2 3\n")
        .unwrap();
    let message = load(folder.path().join("m.obj")).unwrap_err().to_string();
    assert!(message.contains("larger than 8192x8192"), "{message}");
}

#[test]
fn an_inconsistent_model_is_not_saved() {
    let mut model = sample();
    model.meshes[0].triangles[0][1] = 999;
    let folder = tempfile::tempdir().unwrap();
    let message = save_glb(&model, folder.path().join("bad.glb")).unwrap_err().to_string();
    assert!(message.contains("999") && message.contains("bad.glb"), "{message}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    /// Cut and altered files give an error or a consistent model, never a panic.
    #[test]
    fn damaged_files_never_panic(cut in 0usize..4000, edits in prop::collection::vec((0usize..4000, any::<u8>()), 0..6)) {
        static BYTES: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
        let good = BYTES.get_or_init(|| {
            let mut model = sample();
            model.meshes.truncate(1);
            to_glb(&model)
        });
        let mut bytes = good.clone();
        for (at, value) in edits {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        if cut > 2000 {
            bytes.truncate(cut - 2000);
        }
        if let Ok(model) = from_glb(&bytes, "damaged") {
            prop_assert!(model.check().is_ok());
        }
    }

    /// Numbers in the JSON part replaced: indices, counts, offsets, types.
    #[test]
    fn damaged_numbers_never_panic(which in 0usize..200, value in prop::sample::select(vec!["0", "1", "2", "3", "7", "255", "5120", "5123", "5125", "5126", "4294967295", "18446744073709551615", "-1", "1e30"])) {
        let good = to_glb(&Model { meshes: vec![sample().meshes.remove(0)], materials: sample().materials });
        let length = u32::from_le_bytes([good[12], good[13], good[14], good[15]]) as usize;
        let json = std::str::from_utf8(&good[20..20 + length]).unwrap();
        let starts: Vec<usize> = json
            .char_indices()
            .filter(|&(i, c)| c.is_ascii_digit() && i > 0 && b":[,".contains(&json.as_bytes()[i - 1]))
            .map(|(i, _)| i)
            .collect();
        let at = starts[which % starts.len()];
        let end = at + json[at..].find(|c: char| !c.is_ascii_digit()).unwrap();
        let altered = format!("{}{value}{}", &json[..at], &json[end..]);
        let binary = &good[28 + length..];
        if let Ok(model) = from_glb(&glb(&altered, binary), "damaged") {
            prop_assert!(model.check().is_ok());
        }
    }
}

#[test]
fn merged_meshes_keep_their_materials() {
    let model = Model { meshes: vec![merge([cuboid(Vec3::ONE)])], materials: vec![material([0.2; 3], 0.0, 0.9)] };
    let back = from_glb(&to_glb(&model), "m").unwrap();
    assert_eq!(back.materials, model.materials);
}
