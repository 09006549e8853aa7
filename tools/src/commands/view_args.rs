//! Arguments that `fly`, `render` and `bench` share, and their parsers.

use brickfell_culler::{Camera, CameraError};
use brickfell_runtime::renderer::RendererConfig;
use brickfell_runtime::settings::{RenderSettings, sun_direction};
use clap::Args;
use glam::DVec3;

/// Largest picture per axis.
const MAX_PIXELS: u32 = 16_384;

/// Picture, budgets and light.
#[derive(Args, Clone, Debug)]
pub struct ViewArgs {
    /// Picture size in pixels
    #[arg(long, value_name = "WxH", default_value = "640x360", value_parser = parse_size)]
    pub size: (u32, u32),
    /// Vertical field of view, degrees
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = 60.0,
        allow_negative_numbers = true
    )]
    pub fov: f64,
    /// RAM that the pager may hold (bytes, or with K, M, G, KiB, MiB, GiB)
    #[arg(long, value_name = "BYTES", default_value = "1GiB", value_parser = parse_bytes)]
    pub budget_ram: u64,
    /// Device memory for the pools, RAM if the CPU draws (bytes, or with K, M, G, KiB, MiB, GiB)
    #[arg(long, value_name = "BYTES", default_value = "512MiB", value_parser = parse_bytes)]
    pub budget_gpu: u64,
    /// log2 offset on the pixel's footprint before a level is chosen; negative is finer
    #[arg(long, default_value_t = RenderSettings::default().bias, allow_negative_numbers = true)]
    pub bias: f64,
    /// Draw with the CPU's cores, as happens by itself where there is no GPU
    #[arg(long)]
    pub cpu: bool,
    /// Draw with the GPU, or with what stands in for one, though that be slower than the CPU's cores
    #[arg(long, conflicts_with = "cpu")]
    pub gpu: bool,
    /// Sun as azimuth (clockwise from north) and elevation, degrees
    #[arg(long, value_name = "AZ,EL", default_value = "135,45", value_parser = parse_sun, allow_hyphen_values = true)]
    pub sun: (f64, f64),
    /// Surfaces hide the sun from each other
    #[arg(long)]
    pub shadows: bool,
    /// Surfaces hide the sky, where the ambient light comes from, from each other
    #[arg(long)]
    pub occlusion: bool,
}

impl ViewArgs {
    /// Settings for the renderers.
    pub fn settings(&self) -> RenderSettings {
        RenderSettings {
            bias: self.bias,
            sun: sun_direction(self.sun.0, self.sun.1),
            shadows: self.shadows,
            occlusion: self.occlusion,
            ..RenderSettings::default()
        }
    }

    /// Budgets for the renderer.
    pub fn config(&self) -> RendererConfig {
        RendererConfig {
            ram_budget: self.budget_ram,
            gpu_budget: self.budget_gpu,
            ..RendererConfig::default()
        }
    }

    /// A camera.
    ///
    /// # Errors
    /// If no picture can be taken from there.
    pub fn camera(&self, eye: DVec3, target: DVec3) -> Result<Camera, CameraError> {
        Camera::look_at(eye, target, self.fov, self.size.0, self.size.1)
    }
}

fn finite(text: &str) -> Result<f64, String> {
    let value: f64 = text
        .trim()
        .parse()
        .map_err(|_| format!("`{text}` is not a number"))?;
    if value.is_finite() {
        Ok(value)
    } else {
        Err(format!("`{text}` is not a finite number"))
    }
}

/// `X,Y,Z`.
pub fn parse_point(text: &str) -> Result<DVec3, String> {
    let parts = text.split(',').map(finite).collect::<Result<Vec<_>, _>>()?;
    match parts[..] {
        [x, y, z] => Ok(DVec3::new(x, y, z)),
        _ => Err("three numbers are wanted: X,Y,Z in world metres".into()),
    }
}

/// `AZ,EL`.
pub fn parse_sun(text: &str) -> Result<(f64, f64), String> {
    let parts = text.split(',').map(finite).collect::<Result<Vec<_>, _>>()?;
    match parts[..] {
        [azimuth, elevation] => Ok((azimuth, elevation)),
        _ => Err("two numbers are wanted: azimuth,elevation in degrees".into()),
    }
}

/// `WxH`.
pub fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let wrong = || format!("a size is WxH with 1 to {MAX_PIXELS} pixels each, for instance 640x360");
    let (w, h) = text.split_once(['x', 'X']).ok_or_else(wrong)?;
    let side = |s: &str| {
        s.parse()
            .ok()
            .filter(|v| (1..=MAX_PIXELS).contains(v))
            .ok_or_else(wrong)
    };
    Ok((side(w)?, side(h)?))
}

/// A number of bytes, with an optional K, M, G (powers of 1000) or KiB, MiB, GiB (powers of 1024).
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit: f64 = match text[digits.len()..].to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "kb" => 1e3,
        "m" | "mb" => 1e6,
        "g" | "gb" => 1e9,
        "kib" => 1024.0,
        "mib" => 1024.0 * 1024.0,
        "gib" => 1024.0 * 1024.0 * 1024.0,
        other => {
            return Err(format!(
                "`{other}` is not a unit of bytes (K, M, G, KiB, MiB, GiB)"
            ));
        }
    };
    let bytes = finite(digits)? * unit;
    if (1.0..1e18).contains(&bytes) {
        Ok(bytes as u64)
    } else {
        Err(format!("`{text}` is not a usable size"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_bytes_and_points_parse_or_say_why_not() {
        assert_eq!(parse_size("640x360"), Ok((640, 360)));
        assert!(parse_size("0x9").is_err() && parse_size("640").is_err() && parse_size("99999x1").is_err());
        assert_eq!(parse_bytes("1GiB"), Ok(1 << 30));
        assert_eq!(parse_bytes("2.5M"), Ok(2_500_000));
        assert!(parse_bytes("-1").is_err() && parse_bytes("1parsec").is_err() && parse_bytes("NaN").is_err());
        assert_eq!(parse_point("1,-2,3.5"), Ok(DVec3::new(1.0, -2.0, 3.5)));
        assert!(parse_point("1,2").is_err() && parse_point("1,inf,2").is_err());
    }
}
