//! Faults of a reconstruction that COLMAP has made.

use crate::data::layouts::colmap::Facts;
use crate::data::names::listed;
use serde::{Serialize, Serializer};
use std::fmt;

/// Minimum fraction of photographs that have poses. Below it, a reconstruction is torn ([`Fault::Torn`]).
const REGISTERED: f64 = 0.9;
/// The largest reconstruction is torn if a smaller one has at least this many photographs that the largest lacks.
const OTHERS: usize = 3;

/// Fault of a reconstruction: missing photographs, or photographs with wrong poses.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// The reconstruction lacks photographs: they have no pose, or have one in a smaller reconstruction only.
    Torn {
        /// Names of photographs that the largest reconstruction lacks: a list of at least three for each smaller one.
        others: Vec<Vec<String>>,
    },
    /// Two sides of the scene look alike, and photographs of the two sides have poses on one side.
    Folded {
        /// Names of the photographs in each group; poses agree within a group, but not between groups.
        groups: Vec<Vec<String>>,
    },
}

impl Fault {
    /// Finds the fault of `model`, if any. `photographs`: number given to COLMAP. `folded`: groups of a folded model.
    pub(super) fn of(model: &Facts, photographs: usize, folded: Option<Vec<Vec<String>>>) -> Option<Self> {
        if let Some(groups) = folded {
            return Some(Self::Folded { groups });
        }
        let others: Vec<Vec<String>> = model.others.iter().filter(|o| o.len() >= OTHERS).cloned().collect();
        let few = (model.names.len() as f64) < REGISTERED * photographs as f64;
        (few || !others.is_empty()).then_some(Self::Torn { others })
    }
}

impl Serialize for Fault {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let joined = |groups: &[Vec<String>], between: &str| {
            groups.iter().map(|group| listed(group)).collect::<Vec<_>>().join(between)
        };
        match self {
            Self::Torn { others } if others.is_empty() => write!(
                f,
                "torn: photographs are missing in it; take more between those that have a pose and those that have none"
            ),
            Self::Torn { others } => write!(
                f,
                "torn: what these show hangs together only among themselves: {}; of two captures give each a folder, of one \
                 take photographs between the parts",
                joined(others, "; ")
            ),
            Self::Folded { groups } => write!(
                f,
                "folded: two sides that look alike lie on top of each other: {}; find the poses of one group's photographs \
                 alone",
                joined(groups, "; against ")
            ),
        }
    }
}
