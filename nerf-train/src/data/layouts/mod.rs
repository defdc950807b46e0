//! Readers of data sets, one per layout, and the choice between them.

pub(crate) mod bare;
pub(crate) mod blender;
pub(crate) mod choice;
pub(crate) mod colmap;
pub(crate) mod cs180;
pub(crate) mod files;
pub(crate) mod folders;
pub(crate) mod llff;
pub(crate) mod nerfstudio;
pub(crate) mod npz;
pub(crate) mod transforms;
