//! Which part of the work is this process's.

use crate::cli::common::Global;
use crate::lab::Shard;
use clap::Args;

/// One part of the work of several machines.
#[derive(Debug, Args)]
pub struct ShardOption {
    /// Part I of N of the work [default: that of a Slurm or Kubernetes array].
    #[arg(long, value_name = "I/N")]
    pub shard: Option<Shard>,
}

impl ShardOption {
    /// The part that the flag names, or else an array job; says so where it is the array job.
    pub fn choose(&self, global: &Global) -> anyhow::Result<Shard> {
        if let Some(part) = self.shard {
            return Ok(part);
        }
        let found = Shard::of_array(|name| std::env::var(name).ok()).map_err(anyhow::Error::msg)?;
        let Some((variable, part)) = found else { return Ok(Shard::WHOLE) };
        global.say(format!("part {part} of the work, by {variable}"));
        Ok(part)
    }
}
