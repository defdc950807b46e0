//! A part of the work: that of one of several machines.

use std::fmt;
use std::str::FromStr;

/// The part of a sweep that one process runs: `i/n` takes every n-th point, beginning with the i-th.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// `1..=count`.
    pub index: usize,
    /// At least 1.
    pub count: usize,
}

impl Shard {
    /// All of it.
    pub const WHOLE: Self = Self { index: 1, count: 1 };

    /// The part of an array job that this process is: the variable that says so, and the part.
    ///
    /// Slurm: `SLURM_ARRAY_TASK_ID` of `SLURM_ARRAY_TASK_COUNT`, from `SLURM_ARRAY_TASK_MIN` (0 if absent) to `_MAX` by
    /// `_STEP` (1), without gaps. Kubernetes: `JOB_COMPLETION_INDEX`, from 0, of `JOB_COMPLETIONS`, which the job's own
    /// description has to pass on. `variable` reads one.
    ///
    /// # Errors
    /// [`ArrayError`] where the variables do not name one part.
    pub fn of_array(
        variable: impl Fn(&str) -> Option<String>,
    ) -> Result<Option<(&'static str, Self)>, ArrayError> {
        let slurm = Array {
            index: "SLURM_ARRAY_TASK_ID",
            count: "SLURM_ARRAY_TASK_COUNT",
            range: Some(["SLURM_ARRAY_TASK_MIN", "SLURM_ARRAY_TASK_MAX", "SLURM_ARRAY_TASK_STEP"]),
        };
        let kubernetes = Array { index: "JOB_COMPLETION_INDEX", count: "JOB_COMPLETIONS", range: None };
        match (slurm.read(&variable)?, kubernetes.read(&variable)?) {
            (Some((first, part)), Some((second, other))) if part != other => {
                Err(ArrayError::Contradiction { flag: first.into(), part, variable: second, other })
            }
            (slurm, kubernetes) => Ok(slurm.or(kubernetes)),
        }
    }

    /// The part that `--shard` or an array job names; with the variable where that alone says so.
    ///
    /// # Errors
    /// [`ArrayError`] where the variables do not name one part, or another one than the flag.
    pub fn chosen(
        flag: Option<Self>,
        variable: impl Fn(&str) -> Option<String>,
    ) -> Result<(Self, Option<&'static str>), ArrayError> {
        match (flag, Self::of_array(variable)?) {
            (Some(part), Some((variable, other))) if part != other => {
                Err(ArrayError::Contradiction { flag: "--shard".into(), part, variable, other })
            }
            (Some(part), _) => Ok((part, None)),
            (None, Some((variable, part))) => Ok((part, Some(variable))),
            (None, None) => Ok((Self::WHOLE, None)),
        }
    }

    /// Its trials, each with its name.
    pub fn of<T>(self, trials: &[T], name: impl Fn(&T) -> String) -> Vec<(&T, String)> {
        let mine = trials.iter().enumerate().filter(|&(i, _)| self.takes(i));
        mine.map(|(_, trial)| (trial, name(trial))).collect()
    }

    /// Whether the point at `position` is this part's.
    pub fn takes(&self, position: usize) -> bool {
        position % self.count == self.index - 1
    }
}

/// Why it is not known which part of an array job this is.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ArrayError {
    /// A variable is missing or no number.
    #[error("{variable}: expected a whole number beside {index}, found {found}")]
    Number {
        /// The variable.
        variable: &'static str,
        /// The one that says that this is an array job.
        index: &'static str,
        /// What it holds.
        found: String,
    },
    /// A part beyond the last.
    #[error("{index}: expected the index of one of {count} parts ({variable}), found {found}")]
    Beyond {
        /// The variable of the part.
        index: &'static str,
        /// The variable of how many there are.
        variable: &'static str,
        /// How many there are.
        count: usize,
        /// The index as it is.
        found: usize,
    },
    /// The indices of an array are not evenly spaced.
    #[error(
        "{index}: expected an array of {count} evenly spaced indices, found {first} to {last} by {step}: leave none out, or \
         begin with env -u {index} and name the part with --shard"
    )]
    Gaps {
        /// The variable of the part.
        index: &'static str,
        /// How many tasks there are.
        count: usize,
        /// The first index.
        first: usize,
        /// The last.
        last: usize,
        /// The step between two.
        step: usize,
    },
    /// Two say different things.
    #[error(
        "{flag}: expected the part that {variable} names ({other}), found {part}: leave one of them out (env -u {variable})"
    )]
    Contradiction {
        /// The flag, or another variable.
        flag: String,
        /// What it says.
        part: Shard,
        /// The variable.
        variable: &'static str,
        /// What it says.
        other: Shard,
    },
}

/// The variables of a scheduler.
struct Array {
    index: &'static str,
    count: &'static str,
    /// Those of the first index, the last, and the step between two; without, from 0 by 1.
    range: Option<[&'static str; 3]>,
}

impl Array {
    fn read(
        &self,
        variable: impl Fn(&str) -> Option<String>,
    ) -> Result<Option<(&'static str, Shard)>, ArrayError> {
        let Some(text) = variable(self.index) else { return Ok(None) };
        let number = |name: &'static str, text: Option<String>| {
            let found = || text.clone().unwrap_or_else(|| "none".to_owned());
            let number = text.as_ref().and_then(|text| text.trim().parse::<usize>().ok());
            number.ok_or_else(|| ArrayError::Number { variable: name, index: self.index, found: found() })
        };
        let at = number(self.index, Some(text))?;
        let count = number(self.count, variable(self.count))?;
        let or = |name: &'static str, default: usize| match variable(name) {
            Some(text) => number(name, Some(text)),
            None => Ok(default),
        };
        let Some([first, last, step]) = self.range else {
            return self.part(at, count, at.checked_add(1));
        };
        let (first, step) = (or(first, 0)?, or(step, 1)?.max(1));
        let last = or(last, first.saturating_add(step.saturating_mul(count.saturating_sub(1))))?;
        let place = |id: usize| id.checked_sub(first).filter(|way| way % step == 0).map(|way| way / step + 1);
        if place(last) != Some(count) {
            return Err(ArrayError::Gaps { index: self.index, count, first, last, step });
        }
        self.part(at, count, place(at))
    }

    fn part(
        &self,
        at: usize,
        count: usize,
        index: Option<usize>,
    ) -> Result<Option<(&'static str, Shard)>, ArrayError> {
        match index.filter(|index| (1..=count).contains(index)) {
            Some(index) => Ok(Some((self.index, Shard { index, count }))),
            None => Err(ArrayError::Beyond { index: self.index, variable: self.count, count, found: at }),
        }
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

    fn chosen(
        flag: Option<&str>,
        variables: &[(&str, &str)],
    ) -> Result<(Shard, Option<&'static str>), String> {
        let of =
            |name: &str| variables.iter().find(|(n, _)| *n == name).map(|(_, value)| (*value).to_owned());
        Shard::chosen(flag.map(|text| text.parse().expect("a part")), of).map_err(|error| error.to_string())
    }

    #[test]
    fn a_part_is_named_by_the_flag_or_by_an_array_job() {
        let part = |index, count| Shard { index, count };
        assert_eq!(chosen(None, &[]), Ok((Shard::WHOLE, None)));
        assert_eq!(chosen(Some("3/4"), &[]), Ok((part(3, 4), None)));
        let slurm = [
            ("SLURM_ARRAY_TASK_ID", "7"),
            ("SLURM_ARRAY_TASK_COUNT", "4"),
            ("SLURM_ARRAY_TASK_MIN", "1"),
            ("SLURM_ARRAY_TASK_STEP", "2"),
        ];
        assert_eq!(chosen(None, &slurm), Ok((part(4, 4), Some("SLURM_ARRAY_TASK_ID"))));
        assert_eq!(chosen(Some("4/4"), &slurm), Ok((part(4, 4), None)));
        let pod = [("JOB_COMPLETION_INDEX", "0"), ("JOB_COMPLETIONS", "2")];
        assert_eq!(chosen(None, &pod), Ok((part(1, 2), Some("JOB_COMPLETION_INDEX"))));
        assert_eq!(
            chosen(None, &slurm[..2]),
            Err(
                "SLURM_ARRAY_TASK_ID: expected the index of one of 4 parts (SLURM_ARRAY_TASK_COUNT), found 7"
                    .to_owned()
            )
        );
        // --array=1,3,7 and --array=0,2,3.
        for (id, first, last, step) in [("3", "1", "7", "1"), ("2", "0", "3", "2")] {
            let gaps = [
                ("SLURM_ARRAY_TASK_ID", id),
                ("SLURM_ARRAY_TASK_COUNT", "3"),
                ("SLURM_ARRAY_TASK_MIN", first),
                ("SLURM_ARRAY_TASK_MAX", last),
                ("SLURM_ARRAY_TASK_STEP", step),
            ];
            let message = chosen(None, &gaps).expect_err("no part");
            assert!(message.contains("3 evenly spaced") && message.contains("--shard"), "{message}");
        }
    }

    #[test]
    fn what_contradicts_or_is_no_part_is_named() {
        let pod = [("JOB_COMPLETION_INDEX", "1"), ("JOB_COMPLETIONS", "2")];
        for (flag, variables, words) in [
            (Some("1/2"), &pod[..], ["--shard", "JOB_COMPLETION_INDEX", "2/2", "1/2"]),
            (None, &pod[..1], ["JOB_COMPLETIONS", "whole number", "JOB_COMPLETION_INDEX", "none"]),
            (
                None,
                &[pod[0], ("JOB_COMPLETIONS", "many")],
                ["JOB_COMPLETIONS", "whole number", "beside", "many"],
            ),
            (
                None,
                &[("JOB_COMPLETION_INDEX", "2"), pod[1]],
                ["JOB_COMPLETION_INDEX", "one of 2 parts", "JOB_COMPLETIONS", "found 2"],
            ),
            (
                None,
                &[pod[0], pod[1], ("SLURM_ARRAY_TASK_ID", "0"), ("SLURM_ARRAY_TASK_COUNT", "2")],
                ["SLURM_ARRAY_TASK_ID", "JOB_COMPLETION_INDEX", "2/2", "1/2"],
            ),
        ] {
            let message = chosen(flag, variables).expect_err("no part");
            assert!(words.iter().all(|word| message.contains(word)), "{message}");
        }
    }
}
