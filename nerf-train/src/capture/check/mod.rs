//! Checks of a capture before training: viewing directions, sharpness, exposure, shared points and poses.
//!
//! Repeated structure can make a reconstruction superimpose two sides of an orbit. The key points do not reveal such a
//! fold: they agree with the wrong poses. Pixels reveal it: two photographs that see a point from nearly the same place
//! show different content around the point (`pairs.rs`). The photographs then form consistent groups (`groups.rs`).

pub mod after;
mod found;
mod grey;
mod groups;
mod links;
mod pairs;
mod spread;

#[cfg(test)]
mod tests;

use crate::capture::exposure::LogGains;
use crate::data::{Dataset, View};
use crate::system::summary::Short;
use anyhow::{Context, bail};
use found::Found;
use serde::Serialize;

/// Contents and faults of a capture. Photographs are given by name, in the order of names.
#[derive(Clone, Debug, Serialize)]
pub struct Diagnosis {
    pub data: String,
    pub photographs: usize,
    /// Whether the reconstruction superimposes two sides of the scene that look alike; `None` if unknown.
    pub folded: Option<bool>,
    /// Groups of photographs with consistent poses, the largest first; photographs with wrong poses may form a last
    /// group. Empty if all photographs are one group.
    pub groups: Vec<Vec<String>>,
    /// The few photographs that contradict the other photographs and are left out of training.
    pub contradicting: Vec<String>,
    pub compared_pairs: usize,
    pub contradicting_pairs: usize,
    /// Two photographs whose poses cannot both be right; `None` if no two photographs contradict each other.
    pub worst_pair: Option<[String; 2]>,
    /// Largest sector without photographs, degrees of azimuth; `None` if the photographs have no azimuths.
    pub unseen_sector_degrees: Option<Short>,
    pub gaps: Vec<NamedGap>,
    pub blurred: Vec<String>,
    pub duplicates: Vec<[String; 2]>,
    /// Standard deviation, over the photographs, of [`Photograph::exposure`]; `None` if exposure is not measured.
    pub exposure_spread: Option<f64>,
    /// Number of photographs in each connected component (linked by shared points), the largest first.
    pub pieces: Vec<usize>,
    pub bridges: Vec<[String; 2]>,
    pub views: Vec<Photograph>,
    /// Names of the photographs by run ([`spread::runs`]): consecutive names, split where the viewing direction jumps.
    #[serde(skip)]
    runs: Vec<Vec<String>>,
    /// Whether the data have point tracks; `runs` is used only without tracks.
    #[serde(skip)]
    tracks: bool,
    pub facts: String,
    pub findings: Vec<String>,
}

/// A range of azimuths without photographs: its size, and the names of the photographs at its two ends.
#[derive(Clone, Debug, Serialize)]
pub struct NamedGap {
    pub degrees: Short,
    pub between: [String; 2],
}

#[derive(Clone, Debug, Serialize)]
pub struct Photograph {
    pub name: String,
    /// Number of the photograph's group, from 1; `None` if there are no groups, or the photograph is in none.
    pub group: Option<usize>,
    pub azimuth_degrees: Option<Short>,
    /// Variance of the picture's Laplacian, divided by the median of this variance over the nearest photographs.
    pub sharpness: Short,
    /// Natural logarithm of the photograph's brightness relative to the mean of all photographs, averaged over the
    /// colour channels. `None` if too few photographs show enough common points to measure it.
    pub exposure: Option<Short>,
}

impl Diagnosis {
    pub fn of(dataset: &Dataset) -> Self {
        let found = Found::of(dataset);
        let name = |&view: &usize| found.views[view].name.clone();
        let names = |views: &[usize]| views.iter().map(name).collect::<Vec<_>>();
        let pair = |views: [usize; 2]| views.map(|view| name(&view));
        let photograph = |(index, view): (usize, &&View)| Photograph {
            name: view.name.clone(),
            group: found.groups.iter().position(|group| group.contains(&index)).map(|group| group + 1),
            azimuth_degrees: found.spread.as_ref().and_then(|spread| spread.azimuths[index]).map(Short),
            sharpness: Short(found.sharpness[index]),
            exposure: found.gains.as_ref().map(|gains| Short(gains.0[index].iter().sum::<f32>() / 3.0)),
        };
        let gaps = found.spread.iter().flat_map(|spread| &spread.gaps);
        Self {
            data: dataset.name.clone(),
            photographs: found.views.len(),
            folded: found.folded(),
            groups: found.groups.iter().map(|group| names(group)).collect(),
            contradicting: names(&found.outliers),
            compared_pairs: found.pairs.len(),
            contradicting_pairs: found.pairs.iter().filter(|pair| pair.contradicts()).count(),
            worst_pair: found.worst_pair().map(pair),
            unseen_sector_degrees: gaps.clone().next().map(|gap| Short(gap.degrees)),
            gaps: gaps.map(|g| NamedGap { degrees: Short(g.degrees), between: pair(g.between) }).collect(),
            blurred: names(&found.blurred()),
            duplicates: found.duplicates.iter().map(|views| pair(*views)).collect(),
            exposure_spread: found.gains.as_ref().map(LogGains::spread),
            pieces: found.links.pieces.iter().map(Vec::len).collect(),
            bridges: found.links.bridges.iter().map(|bridge| pair(bridge.0)).collect(),
            views: found.views.iter().enumerate().map(photograph).collect(),
            runs: spread::runs(&found.views).iter().map(|run| names(run)).collect(),
            tracks: found.tracks,
            facts: found.facts(),
            findings: found.findings(),
        }
    }

    /// Removes the training photographs in `contradicting` and, with a `group` (counted from 1), the photographs of all
    /// splits outside the group. Fails, without a change, if the group does not exist or has no training view.
    pub fn select(&self, dataset: &mut Dataset, group: Option<usize>) -> anyhow::Result<()> {
        if let Some(found) = group {
            let groups = self.groups.len();
            if groups == 0 {
                let data = &self.data;
                bail!(
                    "--group: expected none, as `check` finds no groups in {data}: all photographs can be fitted together"
                );
            }
            let chosen = found.checked_sub(1).and_then(|index| self.groups.get(index));
            let chosen = chosen.with_context(|| {
                format!("--group: expected 1 to {groups}, a group of photographs that `check` names, found {found}")
            })?;
            if !dataset.train.iter().any(|view| chosen.contains(&view.name)) {
                bail!(
                    "--group: expected a group with training photographs, found all of group {found} held out"
                );
            }
            for views in [&mut dataset.train, &mut dataset.val, &mut dataset.test] {
                views.retain(|view| chosen.contains(&view.name));
            }
        }
        dataset.train.retain(|view| !self.contradicting.contains(&view.name));
        Ok(())
    }

    pub fn lines(&self) -> impl Iterator<Item = &str> {
        std::iter::once(&self.facts).chain(&self.findings).map(String::as_str)
    }
}
