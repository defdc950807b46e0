//! A capture looked over before it is fitted: how its photographs are spread, sharp, exposed and linked, and whether they
//! can all be right.
//!
//! Places that repeat make a reconstruction lay two sides of an orbit on top of each other. Such a folded model agrees
//! with its own key points; its photographs contradict each other's pixels around points that they see from nearly the
//! same place (`pairs.rs`), and fall into groups that are each right alone (`groups.rs`).

pub mod after;
mod grey;
mod groups;
mod links;
mod pairs;
mod spread;
mod words;

#[cfg(test)]
mod tests;

use crate::capture::exposure::LogGains;
use crate::capture::sights::Sights;
use crate::data::{Dataset, View};
use crate::system::summary::Short;
use anyhow::{Context, bail};
use grey::Grey;
use groups::{Groups, few};
use links::Links;
use pairs::Pair;
use rayon::prelude::*;
use serde::Serialize;
use spread::Spread;
use std::collections::BTreeSet;

/// Fewer photographs than this are all fitted, whatever contradicts.
const ENOUGH: usize = 10;
/// Limits from which on a pose is wrong: contradicting key points, and their number over that of agreeing ones.
const MISPLACED: (usize, usize) = (10, 2);

/// What is in a capture and what is wrong with it; photographs by name, in the order of names.
#[derive(Clone, Debug, Serialize)]
pub struct Diagnosis {
    pub data: String,
    pub photographs: usize,
    /// Whether the reconstruction lays two sides that look alike on top of each other; `None` where nothing says.
    pub folded: Option<bool>,
    /// Photographs that can be right together, the largest group first; none where all can.
    pub groups: Vec<Vec<String>>,
    /// Few photographs that contradict the rest, which a fit leaves out.
    pub contradicting: Vec<String>,
    pub compared_pairs: usize,
    pub contradicting_pairs: usize,
    /// Two photographs that cannot both be right.
    pub worst_pair: Option<[String; 2]>,
    /// The largest gap between directions that photographs look from.
    pub unseen_sector_degrees: Option<Short>,
    pub gaps: Vec<NamedGap>,
    pub blurred: Vec<String>,
    pub duplicates: Vec<[String; 2]>,
    /// Standard deviation of log gains, measured at points that several photographs show.
    pub exposure_spread: Option<f64>,
    /// Sizes of the pieces that share points within themselves only.
    pub pieces: Vec<usize>,
    pub bridges: Vec<[String; 2]>,
    pub views: Vec<Photograph>,
    /// Photographs between jumps of the viewing direction in the order of names; whether tracks say more than they do.
    #[serde(skip)]
    runs: Vec<Vec<String>>,
    #[serde(skip)]
    tracks: bool,
    pub facts: String,
    pub findings: Vec<String>,
}

/// A sector from which no photograph looks.
#[derive(Clone, Debug, Serialize)]
pub struct NamedGap {
    pub degrees: Short,
    pub between: [String; 2],
}

#[derive(Clone, Debug, Serialize)]
pub struct Photograph {
    pub name: String,
    /// Its group, counted from 1; `None` where there are no groups, or it contradicts them.
    pub group: Option<usize>,
    pub azimuth_degrees: Option<Short>,
    /// Variance of the Laplacian over that of its neighbours.
    pub sharpness: Short,
    /// Mean log gain.
    pub exposure: Option<Short>,
}

/// Why photographs fall into groups.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Reason {
    Folded,
    Misplaced,
    Pieces,
}

/// What is found, by indices into `views`.
struct Found<'v> {
    views: Vec<&'v View>,
    sharpness: Vec<f32>,
    duplicates: Vec<[usize; 2]>,
    spread: Option<Spread>,
    gains: Option<LogGains>,
    tracks: bool,
    links: Links,
    pairs: Vec<Pair>,
    /// Photographs that take part in a pair.
    judged: usize,
    /// Photographs whose key points contradict their pose.
    misplaced: Vec<usize>,
    groups: Vec<Vec<usize>>,
    reason: Option<Reason>,
    outliers: Vec<usize>,
}

impl<'v> Found<'v> {
    fn of(dataset: &'v Dataset) -> Self {
        let mut views: Vec<&View> =
            [&dataset.train, &dataset.val, &dataset.test].into_iter().flatten().collect();
        views.sort_by(|a, b| a.name.cmp(&b.name));
        let greys: Vec<Grey> = views.par_iter().map(|view| Grey::of(view)).collect();
        let sights = Sights::of(&views, &dataset.points);
        let wrong = |&view: &usize| {
            let (bad, good) = (sights.contradictory[view], sights.of_views[view].len());
            bad >= MISPLACED.0 && bad > MISPLACED.1 * good
        };
        let misplaced: Vec<usize> = (0..views.len()).filter(wrong).collect();
        let mut pairs = pairs::compare(&views, &greys, &sights, &dataset.points);
        pairs.retain(|pair| !pair.views.iter().any(|view| misplaced.contains(view)));
        let judged = pairs.iter().flat_map(|pair| pair.views).collect::<BTreeSet<_>>().len();
        let tracks = sights.count() > 0 || !misplaced.is_empty();
        let mut found = Self {
            sharpness: grey::sharpness(&views, &greys),
            duplicates: grey::duplicates(&greys),
            spread: Spread::of(&views),
            gains: LogGains::measured(&views, &sights),
            tracks,
            links: if tracks { Links::of(&sights, &pairs) } else { Links::default() },
            judged,
            misplaced,
            groups: Vec::new(),
            reason: None,
            outliers: Vec::new(),
            pairs,
            views,
        };
        found.settle_groups();
        found
    }

    /// Groups for the first reason that there is, and the photographs that contradict them.
    fn settle_groups(&mut self) {
        let count = self.views.len();
        let Groups { groups, outliers } = Groups::of(count, &self.pairs);
        self.outliers = outliers;
        let large = self.links.pieces.iter().filter(|piece| piece.len() > few(count));
        let pieces: Vec<Vec<usize>> = large.cloned().collect();
        let (misplaced, right): (Vec<usize>, Vec<usize>) =
            (0..count).partition(|view| self.misplaced.contains(view));
        if groups.len() > 1 {
            (self.groups, self.reason) = (groups, Some(Reason::Folded));
        } else if (few(count) + 1..=count / 2).contains(&misplaced.len()) {
            (self.groups, self.reason) = (vec![right, misplaced], Some(Reason::Misplaced));
        } else if pieces.len() > 1 {
            (self.groups, self.reason) = (pieces, Some(Reason::Pieces));
        }
        if self.misplaced.len() <= few(count) {
            self.outliers.extend(&self.misplaced);
        }
        self.outliers.sort_unstable();
        self.outliers.dedup();
        if self.outliers.len() > few(count) || count < ENOUGH {
            self.outliers.clear();
        }
        let outliers = &self.outliers;
        self.groups.iter_mut().for_each(|group| group.retain(|view| !outliers.contains(view)));
    }

    /// Whether the reconstruction lays two sides that look alike on top of each other; `None` where too few photographs can
    /// be compared.
    fn folded(&self) -> Option<bool> {
        match self.reason {
            Some(Reason::Folded) => Some(true),
            _ => (2 * self.judged >= self.views.len() && self.judged > 0).then_some(false),
        }
    }

    /// The pair that contradicts most, of two groups where there are some.
    fn worst_pair(&self) -> Option<[usize; 2]> {
        let group = |view: usize| self.groups.iter().position(|group| group.contains(&view));
        let bad = self.pairs.iter().filter(|pair| pair.contradicts());
        let apart = |pair: &Pair| group(pair.views[0]) != group(pair.views[1]);
        let worst = bad.max_by(|a, b| {
            apart(a).cmp(&apart(b)).then(a.different.total_cmp(&b.different)).then(b.views.cmp(&a.views))
        });
        worst.map(|pair| pair.views)
    }
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

    /// Keeps the photographs to be fitted. Training photographs that contradict the rest are left out where they are few.
    /// With a `group`, counted from 1, only its photographs are kept, held-out ones included.
    /// Where that fails, the data set is not changed.
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
