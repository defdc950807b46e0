//! What is trained: its settings, its layers and tables, the engines that compute with them, and its way into a blob and
//! from foreign files.

pub mod coded;
pub mod config;
pub mod engine;
pub mod export;
pub mod field;
pub mod import;
pub mod picture_config;
pub mod quantise;
