//! Any bytes as an XML octree: no panic, and what is read converts to binary and back without loss.
#![no_main]

use brickfell_formats::{octree_binary, octree_xml};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    match octree_xml::decode(data) {
        Ok(tree) => {
            let binary = octree_binary::encode(&tree).expect("a tree that was read is valid");
            let xml = octree_xml::encode(&octree_binary::decode(&binary).expect("own file")).expect("valid");
            let again = octree_xml::decode(xml.as_bytes()).expect("own file");
            assert_eq!(octree_binary::encode(&again).expect("valid"), binary);
        }
        Err(e) => assert!(!e.to_string().contains('\n')),
    }
});
