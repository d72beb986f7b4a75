//! The schema for whoever has no copy of the files.

/// A serialised `google.protobuf.FileDescriptorSet` with every file of `proto/plumbline/v1`.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/schema.bin"));

/// The type of [`DESCRIPTORS`].
pub const DESCRIPTORS_NAME: &str = "google.protobuf.FileDescriptorSet";
