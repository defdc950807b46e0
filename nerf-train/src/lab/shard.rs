//! Shards: the parts into which work is divided between processes or machines.

use std::fmt;
use std::str::FromStr;

/// Part of the work that one process does: `i/n` takes every n-th item (run or frame), beginning with the i-th.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Index of this part, from 1 to `count`.
    pub index: usize,
    /// Number of parts, at least 1.
    pub count: usize,
}

impl Shard {
    pub const WHOLE: Self = Self { index: 1, count: 1 };

    /// Returns this process's part of an array job, and the variable with the part's index; `None` outside array jobs.
    /// Fails if a variable is missing or contradicts the others. `read`: reads an environment variable.
    ///
    /// Slurm: `SLURM_ARRAY_TASK_ID` is one of `SLURM_ARRAY_TASK_COUNT` evenly spaced indices. The first index is
    /// `SLURM_ARRAY_TASK_MIN` (default 0), the last `SLURM_ARRAY_TASK_MAX`, the spacing `SLURM_ARRAY_TASK_STEP`
    /// (default 1). Kubernetes: `JOB_COMPLETION_INDEX` counts from 0. `JOB_COMPLETIONS` is the number of parts; the
    /// job's description must set this variable.
    pub fn of_array(read: impl Fn(&str) -> Option<String>) -> Result<Option<(&'static str, Self)>, String> {
        const SLURM: [&str; 5] = [
            "SLURM_ARRAY_TASK_ID",
            "SLURM_ARRAY_TASK_COUNT",
            "SLURM_ARRAY_TASK_MIN",
            "SLURM_ARRAY_TASK_MAX",
            "SLURM_ARRAY_TASK_STEP",
        ];
        const KUBERNETES: [&str; 5] = ["JOB_COMPLETION_INDEX", "JOB_COMPLETIONS", "", "", ""];
        let scheduler = [SLURM, KUBERNETES].into_iter().find(|names| read(names[0]).is_some());
        let Some([id, of, min, max, step]) = scheduler else { return Ok(None) };
        let number = |name: &str, default: Option<usize>| {
            let text = read(name);
            let number = text.as_ref().map_or(default, |text| text.trim().parse().ok());
            let found = text.unwrap_or_else(|| "none".to_owned());
            number.ok_or_else(|| format!("{name}: expected a whole number beside {id}, found {found}"))
        };
        let (at, count) = (number(id, None)?, number(of, None)?);
        let (first, step) = (number(min, Some(0))?, number(step, Some(1))?.max(1));
        let last = first.saturating_add(step.saturating_mul(count.saturating_sub(1)));
        let last = number(max, Some(last))?;
        let place = |id: usize| {
            let way = id.checked_sub(first).filter(|way| way % step == 0);
            way.map_or(0, |way| (way / step).saturating_add(1))
        };
        if place(last) != count || !(1..=count).contains(&place(at)) {
            return Err(format!(
                "{id}: expected one of {count} evenly spaced indices ({of}), found {at}: name the part with --shard"
            ));
        }
        Ok(Some((id, Self { index: place(at), count })))
    }

    pub fn takes(&self, position: usize) -> bool {
        position % self.count == self.index - 1
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let shard = text.split_once('/').and_then(|(index, count)| {
            Some(Self { index: index.trim().parse().ok()?, count: count.trim().parse().ok()? })
        });
        match shard {
            Some(shard) if (1..=shard.count).contains(&shard.index) => Ok(shard),
            _ => Err("expected I/N with I from 1 to N, for example 3/25".into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_array(variables: &[(&str, &str)]) -> Result<Option<(&'static str, Shard)>, String> {
        Shard::of_array(|name| {
            variables.iter().find(|(n, _)| *n == name).map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn an_array_job_names_its_part() {
        let part = |index, count| Shard { index, count };
        assert_eq!(of_array(&[]), Ok(None));
        let slurm = [
            ("SLURM_ARRAY_TASK_ID", "7"),
            ("SLURM_ARRAY_TASK_COUNT", "4"),
            ("SLURM_ARRAY_TASK_MIN", "1"),
            ("SLURM_ARRAY_TASK_STEP", "2"),
        ];
        assert_eq!(of_array(&slurm), Ok(Some(("SLURM_ARRAY_TASK_ID", part(4, 4)))));
        let pod = [("JOB_COMPLETION_INDEX", "0"), ("JOB_COMPLETIONS", "2")];
        assert_eq!(of_array(&pod), Ok(Some(("JOB_COMPLETION_INDEX", part(1, 2)))));
    }

    #[test]
    fn what_is_no_part_is_named() {
        let pod = [("JOB_COMPLETION_INDEX", "1"), ("JOB_COMPLETIONS", "2")];
        let gaps = |id, first, last, step| {
            [
                ("SLURM_ARRAY_TASK_ID", id),
                ("SLURM_ARRAY_TASK_COUNT", "3"),
                ("SLURM_ARRAY_TASK_MIN", first),
                ("SLURM_ARRAY_TASK_MAX", last),
                ("SLURM_ARRAY_TASK_STEP", step),
            ]
        };
        // Unevenly spaced indices: --array=1,3,7 and --array=0,2,3.
        let (odd, even) = (gaps("3", "1", "7", "1"), gaps("2", "0", "3", "2"));
        for (variables, words) in [
            (&pod[..1], ["JOB_COMPLETIONS", "whole number", "JOB_COMPLETION_INDEX", "none"]),
            (&[pod[0], ("JOB_COMPLETIONS", "many")], ["JOB_COMPLETIONS", "whole number", "beside", "many"]),
            (
                &[("JOB_COMPLETION_INDEX", "2"), pod[1]],
                ["JOB_COMPLETION_INDEX", "one of 2", "JOB_COMPLETIONS", "found 2"],
            ),
            (&odd, ["SLURM_ARRAY_TASK_ID", "3 evenly spaced", "found 3", "--shard"]),
            (&even, ["SLURM_ARRAY_TASK_ID", "3 evenly spaced", "found 2", "--shard"]),
        ] {
            let message = of_array(variables).expect_err("no part");
            assert!(words.iter().all(|word| message.contains(word)), "{message}");
        }
    }
}
