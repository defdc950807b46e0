//! Which part of the work is this process's.

use crate::cli::common::Global;
use crate::lab::Shard;
use clap::Args;

/// One part of the work of several machines.
#[derive(Debug, Args)]
pub struct ShardOption {
    /// Only every N-th part of the work, beginning with the I-th (from 1) [default: that of a Slurm or Kubernetes array].
    #[arg(long, value_name = "I/N")]
    pub shard: Option<Shard>,
}

impl ShardOption {
    /// The part that the flag or an array job names; says so where it is the array job.
    pub fn choose(&self, global: &Global) -> anyhow::Result<Shard> {
        let (part, variable) = Shard::chosen(self.shard, |name| std::env::var(name).ok())?;
        if let Some(variable) = variable {
            global.say(format!("part {part} of the work, by {variable}"));
        }
        Ok(part)
    }
}
