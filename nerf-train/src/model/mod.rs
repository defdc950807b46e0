//! Models and their training: settings, layers and tables, the engines that compute gradients, and export to a blob.

pub mod coded;
pub mod config;
pub mod engine;
pub mod export;
pub mod field;
pub mod picture_config;
pub mod quantise;
