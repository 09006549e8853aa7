//! What the window keeps of a user from one run to the next: a small JSON file in the user's folder for settings.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::commands::view::Args;

/// Settings of the window.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(default)]
pub(super) struct Kept {
    /// Figures and sliders are shown.
    pub(super) hud: bool,
    /// log2 offset on the footprint.
    pub(super) bias: f64,
    /// Azimuth and elevation, degrees.
    pub(super) sun: [f64; 2],
    /// What lies farther is not drawn.
    pub(super) range_km: f64,
    /// Milliseconds of a frame while the camera moves; 0: as many as it takes.
    pub(super) target_ms: f64,
    pub(super) shadows: bool,
    pub(super) occlusion: bool,
    pub(super) ram_mib: u64,
    pub(super) gpu_mib: u64,
    /// Pixels of the window.
    pub(super) size: [u32; 2],
}

impl Default for Kept {
    fn default() -> Self {
        Self {
            hud: true,
            bias: -1.0,
            sun: [135.0, 45.0],
            range_km: 1000.0,
            target_ms: 33.0,
            shadows: false,
            occlusion: false,
            ram_mib: 1024,
            gpu_mib: 512,
            size: [1280, 720],
        }
    }
}

fn file() -> Option<PathBuf> {
    Some(dirs::config_dir()?.join("brickfell").join("view.json"))
}

impl Kept {
    /// As they were left. A file that is missing or makes no sense counts as none.
    pub(super) fn load() -> Self {
        let text = file().and_then(|file| std::fs::read(file).ok());
        let kept: Self = text
            .and_then(|text| serde_json::from_slice(&text).ok())
            .unwrap_or_default();
        kept.in_range()
    }

    /// With what is asked for in this run.
    pub(super) fn with(self, args: &Args) -> Self {
        let mib = |bytes: Option<u64>, kept: u64| bytes.map_or(kept, |b| b >> 20);
        Self {
            bias: args.bias.unwrap_or(self.bias),
            sun: args
                .sun
                .map_or(self.sun, |(azimuth, elevation)| [azimuth, elevation]),
            target_ms: args.target_ms.unwrap_or(self.target_ms),
            shadows: self.shadows || args.shadows,
            occlusion: self.occlusion || args.occlusion,
            ram_mib: mib(args.budget_ram, self.ram_mib),
            gpu_mib: mib(args.budget_gpu, self.gpu_mib),
            size: args.size.map_or(self.size, |(width, height)| [width, height]),
            ..self
        }
        .in_range()
    }

    /// Within what the sliders give.
    fn in_range(self) -> Self {
        let default = Self::default();
        let finite = |x: f64, low: f64, high: f64, default: f64| {
            if x.is_finite() {
                x.clamp(low, high)
            } else {
                default
            }
        };
        Self {
            bias: finite(self.bias, -3.0, 4.0, default.bias),
            sun: [
                finite(self.sun[0], 0.0, 360.0, default.sun[0]),
                finite(self.sun[1], 0.0, 90.0, default.sun[1]),
            ],
            range_km: finite(self.range_km, 0.1, 1000.0, default.range_km),
            target_ms: finite(self.target_ms, 0.0, 200.0, default.target_ms),
            ram_mib: self.ram_mib.clamp(64, 16384),
            gpu_mib: self.gpu_mib.clamp(32, 16384),
            size: self.size.map(|s| s.clamp(64, 16384)),
            ..self
        }
    }

    /// Writes them.
    ///
    /// # Errors
    /// If there is no place for them, or none to write to.
    pub(super) fn save(&self) -> std::io::Result<()> {
        let file = file().ok_or_else(|| std::io::Error::other("there is no folder for a user's settings"))?;
        if let Some(folder) = file.parent() {
            std::fs::create_dir_all(folder)?;
        }
        std::fs::write(file, serde_json::to_vec_pretty(self)?)
    }

    pub(super) fn ram_bytes(&self) -> u64 {
        self.ram_mib << 20
    }

    pub(super) fn gpu_bytes(&self) -> u64 {
        self.gpu_mib << 20
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_comes_back_and_what_makes_no_sense_does_not() {
        let kept = Kept {
            bias: 0.5,
            sun: [10.0, 20.0],
            ..Kept::default()
        };
        let text = serde_json::to_string(&kept).unwrap();
        assert_eq!(serde_json::from_str::<Kept>(&text).unwrap().in_range(), kept);
        let odd = r#"{"bias": 1e300, "ram_mib": 0, "size": [0, 999999], "of another version": 1}"#;
        let kept = serde_json::from_str::<Kept>(odd).unwrap().in_range();
        assert_eq!((kept.bias, kept.ram_mib, kept.size), (4.0, 64, [64, 16384]));
    }
}
