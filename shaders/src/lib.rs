//! The WGSL of brickfell, in files by topic, and the Rust types that share its memory layout.
//!
//! A kernel's source is `frame.wgsl` (the shared structures) followed by the files of its topic. Nothing here needs a GPU:
//! the tests parse and validate every source with naga and compare the structures' offsets with [`layout`].
//!
//! The crate is for `brickfell-runtime`, which fills and binds all that the kernels want. By itself it is of use to who reads what rays
//! report:
//!
//! ```
//! use brickfell_shaders::layout::Request;
//!
//! // The second tree of the frame's list lacks the node (5, 6, 7) of level 3.
//! let words = [2 | 3 << 16, 5 | 6 << 20, 7 << 8];
//! assert_eq!(Request::unpack(words), Some(Request { tree: 1, level: 3, node: [5, 6, 7] }));
//! assert_eq!(Request::unpack([0; 3]), None);
//! ```
//!
//! Constants that override those of the ray caster (`SUN_CONES`, `SKY_CONES`, `SHOWS`, `ENDS`, `DEPTHS`) are 0 unless something is asked
//! for, and then cost nothing; its bindings are there all the same. Constants and plain values: any thread, no errors.
//!
//! [docs/raycasting.md](https://github.com/brickfell/brickfell/blob/main/docs/raycasting.md) has the rules that the kernels follow.

pub mod layout;

/// The ray caster: entry point `cast_rays`, workgroups of 8×8 pixels.
pub const CAST: &str = concat!(
    include_str!("wgsl/frame.wgsl"),
    include_str!("wgsl/shade.wgsl"),
    include_str!("wgsl/surface.wgsl"),
    include_str!("wgsl/cast.wgsl")
);

/// Lists of trees: entry point `list_trees`, 64 tiles of 8×8 pixels.
pub const LISTS: &str = concat!(include_str!("wgsl/frame.wgsl"), include_str!("wgsl/lists.wgsl"));

/// Where rays begin: entry point `start_rays`, 64 tiles of 8×8 pixels.
pub const BEAM: &str = concat!(include_str!("wgsl/frame.wgsl"), include_str!("wgsl/beam.wgsl"));

/// Feedback compaction: entry points `compact_pixels` (64 spans of 64 pixels) and `compact_usage` (64 words).
pub const COMPACT: &str = concat!(include_str!("wgsl/frame.wgsl"), include_str!("wgsl/compact.wgsl"));

/// The picture onto a window: entry points `whole_target` and `over_sky`.
pub const PRESENT: &str = include_str!("wgsl/present.wgsl");

/// Uploads: entry points `scatter_nodes` (64 words) and `scatter_bricks` (64 samples × one brick).
pub const SCATTER: &str = include_str!("wgsl/scatter.wgsl");

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::offset_of;

    fn module(source: &str) -> naga::Module {
        let module =
            naga::front::wgsl::parse_str(source).unwrap_or_else(|e| panic!("{}", e.emit_to_string(source)));
        naga::valid::Validator::new(
            naga::valid::ValidationFlags::all(),
            naga::valid::Capabilities::default(),
        )
        .validate(&module)
        .unwrap_or_else(|e| panic!("{}", e.emit_to_string(source)));
        module
    }

    fn struct_layout(module: &naga::Module, name: &str) -> (Vec<(String, u32)>, u32) {
        let (_, ty) = module
            .types
            .iter()
            .find(|(_, t)| t.name.as_deref() == Some(name))
            .unwrap();
        let naga::TypeInner::Struct { members, span } = &ty.inner else {
            panic!("{name} is no struct")
        };
        (
            members
                .iter()
                .map(|m| (m.name.clone().unwrap(), m.offset))
                .collect(),
            *span,
        )
    }

    macro_rules! assert_layout {
        ($module:expr, $rust:ty, $name:literal, [$($field:ident),* $(,)?]) => {{
            let (members, span) = struct_layout($module, $name);
            assert_eq!(span as usize, size_of::<$rust>(), $name);
            $(assert!(
                members.contains(&(stringify!($field).into(), offset_of!($rust, $field) as u32)),
                "{}.{} is at {}, not among {members:?}", $name, stringify!($field), offset_of!($rust, $field)
            );)*
        }};
    }

    #[test]
    fn every_source_validates_and_shares_its_layout_with_rust() {
        let cast = module(CAST);
        module(LISTS);
        module(BEAM);
        module(COMPACT);
        let scatter = module(SCATTER);
        let present = module(PRESENT);
        assert_layout!(
            &cast,
            layout::Frame,
            "Frame",
            [
                size,
                tree_count,
                frame,
                screen_origin,
                screen_step,
                forward,
                right,
                up,
                sun,
                diffuse,
                footprint,
                fade,
                blocks,
                slots,
                texel,
                brick_slots,
                node_tiles,
                request_capacity,
                request_share,
                segment_shift,
                segment_samples,
                lists,
                slot,
                normal_scale,
                normal_zero,
                sky_middle,
                cones,
                pixels,
                depth_in,
            ]
        );
        assert_layout!(
            &cast,
            layout::Tree,
            "Tree",
            [
                base,
                depth0,
                base_x,
                inv_voxel,
                base_y,
                log2_root_voxel,
                root,
                depth,
                gain,
                texel_offset,
                cell,
                rim,
                max_steps,
                least_level,
            ]
        );
        assert_layout!(
            &present,
            layout::Present,
            "Present",
            [forward, right, up, horizon, zenith, drawn, size, half, encode]
        );
        assert_layout!(
            &scatter,
            layout::Scatter,
            "Scatter",
            [nodes, bricks, brick_side, slots]
        );
    }

    #[test]
    fn sizes_in_words_are_those_of_rust() {
        let has = |source: &str, name: &str, words: usize| {
            assert!(
                source.contains(&format!("const {name}: u32 = {words}u;")),
                "{name}"
            );
        };
        has(CAST, "OCCUPANCY_WORDS", layout::OCCUPANCY_WORDS);
        has(SCATTER, "OCCUPANCY_WORDS", layout::OCCUPANCY_WORDS);
        has(CAST, "LIST_WORDS", layout::LIST_WORDS);
        has(CAST, "COUNTER_WORDS", layout::COUNTER_WORDS);
        has(CAST, "TABLE_WORDS", layout::TABLE_WORDS);
    }

    #[test]
    fn requests_unpack_as_the_rays_pack_them() {
        let (tree, level, p) = (65_000u32, 20u32, [0xf_fffeu32, 0xa_bcde, 0x1_2345]);
        // As `ask` in cast.wgsl.
        let words = [
            (tree + 1) | level << 16,
            p[0] | p[1] << 20,
            p[1] >> 12 | p[2] << 8,
        ];
        assert_eq!(
            layout::Request::unpack(words),
            Some(layout::Request {
                tree,
                level: 20,
                node: p
            })
        );
        assert_eq!(layout::Request::unpack([0, 5, 6]), None);
    }
}
