//! Ranges of every value of a scene configuration.

use super::{ConfigurationError, SceneConfiguration, Surface};

/// Collects range checks of one scene.
struct Check<'a>(&'a str);

impl Check<'_> {
    fn fail(&self, field: &str, found: impl ToString, expected: impl ToString) -> ConfigurationError {
        ConfigurationError::Range {
            scene: self.0.to_owned(),
            field: field.to_owned(),
            found: found.to_string(),
            expected: expected.to_string(),
        }
    }

    fn within(&self, field: &str, value: impl Into<f64>, low: f64, high: f64) -> Result<(), ConfigurationError> {
        let value = value.into();
        if (low..=high).contains(&value) {
            return Ok(());
        }
        Err(self.fail(field, value, format!("in [{low}, {high}]")))
    }

    fn surface(&self, field: &str, s: &Surface) -> Result<(), ConfigurationError> {
        self.within(&format!("{field}.contrast"), s.contrast, 0.0, 1.5)?;
        self.within(&format!("{field}.wear"), s.wear, 0.0, 1.0)?;
        self.within(&format!("{field}.scale"), s.scale, 0.3 - 1e-6, 4.0)?;
        self.within(&format!("{field}.roughness"), s.roughness, 0.05 - 1e-6, 1.0)?;
        self.within(&format!("{field}.texels"), s.texels, 64.0, 4096.0)
    }
}

impl SceneConfiguration {
    /// Checks every value against its range; the message names the scene and the field.
    pub fn validate(&self) -> Result<(), ConfigurationError> {
        let check = Check(&self.name);
        if !self.name.starts_with(&format!("{}_", self.split.id())) {
            return Err(check.fail("name", &self.name, format!("prefixed by `{}_`", self.split.id())));
        }
        let room = &self.room;
        for (i, axis) in ["x", "y", "z"].iter().enumerate() {
            let low = if i == 2 { 2.2 } else { 2.4 };
            check.within(&format!("room.size_m.{axis}"), room.size_m[i], low - 1e-6, 12.0)?;
        }
        check.surface("room.floor", &room.floor)?;
        check.surface("room.wall", &room.wall)?;
        check.surface("room.wood", &room.wood)?;
        check.within("room.decor_density", room.decor_density, 0.0, 1.0)?;
        self.validate_table(&check)?;
        self.validate_light(&check)?;
        self.validate_ellipse(&check)
    }

    fn validate_table(&self, check: &Check<'_>) -> Result<(), ConfigurationError> {
        let (table, clutter) = (&self.table, &self.clutter);
        check.within("table.height_m", table.height_m, 0.6 - 1e-6, 0.95 + 1e-6)?;
        check.surface("table.top", &table.top)?;
        check.surface("table.frame", &table.frame)?;
        for (i, axis) in ["x", "y"].iter().enumerate() {
            check.within(&format!("table.size_m.{axis}"), table.size_m[i], 0.6 - 1e-6, 3.0)?;
            let reach = table.center_m[i].abs() + table.size_m[i] / 2.0;
            if reach > self.room.size_m[i] / 2.0 {
                return Err(check.fail(&format!("table.size_m.{axis}"), table.size_m[i], "inside the room"));
            }
            let half = f64::from(table.size_m[i]) / 2.0;
            check.within(&format!("clutter.extent_m.{axis}"), clutter.extent_m[i], 0.1 - 1e-6, half)?;
        }
        check.within("clutter.tightness", clutter.tightness, 0.0, 1.0)?;
        check.within("clutter.gap_m", clutter.gap_m, 0.002 - 1e-6, 0.05)?;
        let [low, high] = clutter.distractors;
        if low < 7 || high > 14 || low > high {
            return Err(check.fail("clutter.distractors", format!("[{low}, {high}]"), "within 7 to 14, smaller first"));
        }
        Ok(())
    }

    fn validate_light(&self, check: &Check<'_>) -> Result<(), ConfigurationError> {
        let light = &self.light;
        for (i, axis) in ["x", "y", "z"].iter().enumerate() {
            let half = f64::from(self.room.size_m[i]) / 2.0;
            let (low, high) = if i == 2 { (f64::from(self.table.height_m) + 0.7, 2.0 * half) } else { (-half, half) };
            check.within(&format!("light.position_m.{axis}"), light.position_m[i], low, high)?;
        }
        check.within("light.radius_m", light.radius_m, 0.0, 0.6)?;
        check.within("light.exposure", light.exposure, 0.2, 4.0)?;
        for (field, values, high) in
            [("intensity", light.intensity, 20.0), ("sky", light.sky, 3.0), ("ground", light.ground, 3.0)]
        {
            for v in values {
                check.within(&format!("light.{field}"), v, 0.0, high)?;
            }
        }
        for glow in &light.glows {
            let length = glow.direction.iter().map(|v| v * v).sum::<f32>().sqrt();
            check.within("light.glows.direction length", length, 1e-3, 1e3)?;
            check.within("light.glows.sharpness", glow.sharpness, 1.0, 200.0)?;
            for v in glow.color {
                check.within("light.glows.color", v, 0.0, 10.0)?;
            }
        }
        Ok(())
    }

    fn validate_ellipse(&self, check: &Check<'_>) -> Result<(), ConfigurationError> {
        let e = &self.ellipse;
        check.within("ellipse.camera_height_m", e.camera_height_m, 1.4, 1.6)?;
        for (i, axis) in ["x", "y"].iter().enumerate() {
            check.within(&format!("ellipse.semi_axes_m.{axis}"), e.semi_axes_m[i], 0.5, 0.85)?;
            let reach = e.center_m[i].abs() + e.semi_axes_m[i];
            // Furniture along the walls is up to 0.45 m deep.
            if reach > f64::from(self.room.size_m[i]) / 2.0 - 0.5 {
                return Err(check.fail(&format!("ellipse.center_m.{axis}"), e.center_m[i], "0.5 m clear of the walls"));
            }
        }
        Ok(())
    }
}
