//! Tables between sRGB codes and linear light, laid out for inner loops.

use std::sync::LazyLock;

use brickfell_formats::value::srgb_to_linear;

/// Linear light (0..1) of each sRGB code.
pub(crate) static LINEAR: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|code| srgb_to_linear(code as u8)));

/// Linear light of an sRGB value between 0 and 1 that need not be an 8-bit code (material colours).
pub(crate) fn linear_of(srgb: f32) -> f32 {
    let s = srgb.clamp(0.0, 1.0);
    if s <= 0.04045 {
        s / 12.92
    } else {
        ((s + 0.055) / 1.055).powf(2.4)
    }
}

/// A straight sRGB pixel as premultiplied linear light.
#[inline]
pub(crate) fn premultiplied(table: &[f32; 256], pixel: [u8; 4]) -> [f32; 4] {
    let a = f32::from(pixel[3]) * (1.0 / 255.0);
    [
        table[usize::from(pixel[0])] * a,
        table[usize::from(pixel[1])] * a,
        table[usize::from(pixel[2])] * a,
        a,
    ]
}
