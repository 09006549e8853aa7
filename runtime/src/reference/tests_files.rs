//! The files behind a picture: XML and binary trees, damaged and missing ones.

use brickfell_culler::Camera;
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::{octree_binary, octree_xml};
use brickfell_pager::store::{Fault, Store as _};
use glam::{DVec3, UVec3};

use super::testing::*;
use crate::settings::RenderSettings;

#[test]
fn damaged_and_missing_files_are_named() {
    let whole = || {
        let mut store = Store::default();
        let head = header(DVec3::ZERO, 1.0, 1, SampleLayout::Corner, 1);
        store.add("a/t.oct", head, |_, _| Kind::Brick, |_, _| grey(9, 9));
        store
    };
    let camera = Camera::look_at(DVec3::splat(40.0), DVec3::ZERO, 30.0, 8, 8).unwrap();
    let settings = RenderSettings {
        bias: -9.0,
        ..RenderSettings::default()
    };
    let draw = |store: Store| {
        store
            .try_open(&["a/t.oct"])
            .and_then(|r| r.render(&camera, &settings))
    };
    assert!(draw(whole()).unwrap().1.rays_hit > 0);

    let broken_by = |name: &str, fault: Option<Fault>| {
        let store = whole();
        match fault {
            Some(fault) => store.0.inject(name, fault),
            None => store.0.remove(name),
        }
        let said = draw(store).unwrap_err().to_string();
        assert!(
            said.starts_with(&format!("memory:{name}: ")) && !said.contains('\n'),
            "{fault:?}: {said}"
        );
    };
    for name in ["a/t.oct", "a/t.L01.brk"] {
        broken_by(name, None);
        broken_by(name, Some(Fault::Error(std::io::ErrorKind::PermissionDenied)));
        broken_by(name, Some(Fault::Short));
        let len = whole().0.len(name).unwrap();
        for at in [0, 9, 50, len / 2, len - 1] {
            broken_by(name, Some(Fault::FlipBit(at * 8)));
            let store = whole();
            store.0.truncate(name, at as usize);
            assert!(draw(store).unwrap_err().to_string().contains(name), "{at}");
        }
    }
    // A brick file of another level of the same tree is sound but wrong.
    let store = whole();
    let coarse = store
        .0
        .read("a/t.L00.brk", 0, store.0.len("a/t.L00.brk").unwrap() as usize)
        .unwrap();
    store.0.put("a/t.L01.brk", coarse);
    assert!(draw(store).unwrap_err().to_string().contains("holds level 0"));
}

#[test]
fn an_xml_tree_draws_as_its_binary_does() {
    let camera = Camera::look_at(DVec3::splat(40.0), DVec3::ZERO, 30.0, 16, 16).unwrap();
    let draw = |xml: bool| {
        let mut store = Store::default();
        let head = header(DVec3::ZERO, 1.0, 1, SampleLayout::Corner, 1);
        let kind = |level, p: UVec3| {
            if level == 1 && p.x == 0 {
                Kind::Leaf([9, 0, 0, 9])
            } else {
                Kind::Brick
            }
        };
        store.add("t.oct", head, kind, |_, p| grey(p.x as u8, 20));
        if xml {
            let bytes = store
                .0
                .read("t.oct", 0, store.0.len("t.oct").unwrap() as usize)
                .unwrap();
            let text = octree_xml::encode(&octree_binary::decode(&bytes).unwrap()).unwrap();
            store.0.put("t.oct", text.into_bytes());
        }
        store
            .open(&["t.oct"])
            .render(
                &camera,
                &RenderSettings {
                    bias: -3.0,
                    ..Default::default()
                },
            )
            .unwrap()
    };
    let (binary, xml) = (draw(false), draw(true));
    assert!(binary.1.samples > 0);
    assert_eq!(binary, xml);
}
