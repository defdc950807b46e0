//! Findings of the check, as indices of photographs and as sentences that advise what to do.

use super::grey::{self, Grey, is_blurred};
use super::groups::{Groups, few};
use super::links::Links;
use super::pairs::{self, Pair};
use super::spread::Spread;
use crate::capture::exposure::{CALLED_FOR, LogGains};
use crate::capture::sights::Sights;
use crate::data::names::count;
use crate::data::{Dataset, View};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Minimum number of photographs in a capture for contradicting photographs to be left out of training.
const ENOUGH: usize = 10;
/// Limits for a wrong pose: at least `.0` points project far from their key points, and these points are more than `.1`
/// times as many as the points that project near their key points.
const MISPLACED: (usize, usize) = (10, 2);
/// Smallest sector without photographs that is reported, degrees of azimuth.
const WIDE_GAP: f32 = 60.0;
/// Maximum number of names, or ranges of names, in a list. Further photographs are only counted.
const LISTED: usize = 6;
/// Minimum size, in photographs, of each of the two parts of a capture that a single link connects. If a part is
/// smaller, the link is not reported.
const HANGING: usize = 3;

/// Reason why photographs fall into groups: a folded reconstruction (two sides of the scene are superimposed), wrong
/// poses, or pieces without shared points.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Reason {
    Folded,
    Misplaced,
    Pieces,
}

/// Findings of the check. Each photograph is given as its index in `views`.
pub(super) struct Found<'v> {
    pub views: Vec<&'v View>,
    pub sharpness: Vec<f32>,
    pub duplicates: Vec<[usize; 2]>,
    pub spread: Option<Spread>,
    pub gains: Option<LogGains>,
    pub tracks: bool,
    pub links: Links,
    pub pairs: Vec<Pair>,
    /// Number of photographs that occur in at least one compared pair.
    judged: usize,
    misplaced: Vec<usize>,
    pub groups: Vec<Vec<usize>>,
    reason: Option<Reason>,
    pub outliers: Vec<usize>,
}

impl<'v> Found<'v> {
    pub fn of(dataset: &'v Dataset) -> Self {
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

    /// Sets `groups` by the first [`Reason`], in order of declaration, that applies; `groups` stays empty if no reason
    /// applies. Sets `outliers` to the few photographs with contradicting poses, and removes them from `groups`.
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

    /// Whether the reconstruction superimposes two similar sides of the scene; `None` if too few pairs can be compared.
    pub fn folded(&self) -> Option<bool> {
        match self.reason {
            Some(Reason::Folded) => Some(true),
            _ => (2 * self.judged >= self.views.len() && self.judged > 0).then_some(false),
        }
    }

    /// Returns, of the pairs of photographs that contradict each other, the pair with the largest fraction of differing
    /// patches. A pair from two groups takes precedence. `None` if no two photographs contradict each other.
    pub fn worst_pair(&self) -> Option<[usize; 2]> {
        let group = |view: usize| self.groups.iter().position(|group| group.contains(&view));
        let bad = self.pairs.iter().filter(|pair| pair.contradicts());
        let apart = |pair: &Pair| group(pair.views[0]) != group(pair.views[1]);
        let worst = bad.max_by(|a, b| {
            apart(a).cmp(&apart(b)).then(a.different.total_cmp(&b.different)).then(b.views.cmp(&a.views))
        });
        worst.map(|pair| pair.views)
    }

    fn name(&self, view: usize) -> &str {
        &self.views[view].name
    }

    /// Returns the indices of the photographs that are much less sharp than those with the nearest poses.
    pub fn blurred(&self) -> Vec<usize> {
        (0..self.views.len()).filter(|&view| is_blurred(self.sharpness[view])).collect()
    }

    /// Returns the names of `views`, with consecutive photographs written as `first to last`.
    fn listed(&self, views: &[usize]) -> String {
        let mut runs: Vec<[usize; 2]> = Vec::new();
        for &view in views {
            match runs.last_mut() {
                Some([_, last]) if *last + 1 == view => *last = view,
                _ => runs.push([view, view]),
            }
        }
        let shown = |[first, last]: &[usize; 2]| match last - first {
            0 => self.name(*first).to_owned(),
            _ => format!("{} to {}", self.name(*first), self.name(*last)),
        };
        let more = match runs.len().saturating_sub(LISTED) {
            0 => String::new(),
            _ => {
                let left: usize = runs[LISTED..].iter().map(|[first, last]| last - first + 1).sum();
                format!(" and {left} more")
            }
        };
        runs.iter().take(LISTED).map(shown).collect::<Vec<_>>().join(", ") + &more
    }

    pub fn facts(&self) -> String {
        let mut parts = Vec::new();
        parts.push(match &self.spread {
            Some(spread) => {
                let around = if spread.inward { "around what they show" } else { "looking outward" };
                let gap = spread.gaps.first().map_or(360.0, |gap| gap.degrees);
                format!("{around}, largest unseen sector {gap:.0}°")
            }
            None => "looking much the same way".into(),
        });
        parts.push(format!("{} blurred", self.blurred().len()));
        parts.push(count(self.duplicates.len(), "duplicate"));
        if let Some(gains) = &self.gains {
            parts.push(format!("exposure spread {:.1} %", 100.0 * gains.spread()));
        }
        if self.tracks {
            parts.push(format!("{} linked by shared points", count(self.links.pieces.len(), "piece")));
            let bad = self.pairs.iter().filter(|pair| pair.contradicts()).count();
            let pairs = count(self.pairs.len(), "pair");
            parts.push(format!("{pairs} compared at points seen alike, {bad} contradict each other"));
        }
        format!("check: {}: {}", count(self.views.len(), "photograph"), parts.join("; "))
    }

    /// Returns one sentence for each fault, and for each check that was not possible; the most important first.
    pub fn findings(&self) -> Vec<String> {
        let mut findings = vec![self.fold()];
        findings.extend(self.contradicting());
        findings.extend(self.linked());
        findings.extend(self.sector());
        findings.extend(self.pictures());
        findings.into_iter().filter(|finding| !finding.is_empty()).collect()
    }

    /// Returns the groups as text, with numbers of photographs: `group 1 (39): …; group 2 (32): …`.
    fn groups(&self) -> String {
        let group = |(index, group): (usize, &Vec<usize>)| {
            format!("group {} ({}): {}", index + 1, group.len(), self.listed(group))
        };
        self.groups.iter().enumerate().map(group).collect::<Vec<_>>().join("; ")
    }

    fn fold(&self) -> String {
        if self.reason == Some(Reason::Folded) {
            return format!(
                "folded: photographs that see the same points show different things there, so poses of two sides were laid \
                 on top of each other; {}; find the poses again in the order of capture (poses --sequential), or fit one \
                 side alone with --group 1",
                self.groups()
            );
        }
        match self.folded() {
            Some(_) => String::new(),
            None if self.tracks => format!(
                "whether the poses are folded cannot be judged before the fit: only {} of {} see points like another does",
                self.judged,
                count(self.views.len(), "photograph")
            ),
            None => "whether the poses are folded cannot be judged before the fit, as the data have no tracks of points: \
                     compare the training PSNR of groups after it"
                .into(),
        }
    }

    fn contradicting(&self) -> Vec<String> {
        let (wrong, all) = (self.misplaced.len(), self.views.len());
        let mut found = Vec::new();
        if !self.outliers.is_empty() {
            found.push(format!(
                "{} the rest: {}; fit leaves them out of training: take them out of the capture, or find their poses again",
                subject(self.outliers.len(), "contradicts", "contradict"),
                self.listed(&self.outliers)
            ));
        }
        if self.reason == Some(Reason::Misplaced) {
            found.push(format!(
                "the key points of {wrong} photographs contradict their poses; {}; fit the rest with --group 1, or find the \
                 poses again",
                self.groups()
            ));
        } else if wrong > few(all) || wrong > 0 && all < ENOUGH {
            found.push(format!(
                "the key points of {wrong} of {all} photographs contradict their poses: photographs and poses are not of \
                 one reconstruction; find the poses again"
            ));
        }
        found
    }

    fn linked(&self) -> Vec<String> {
        let pieces = &self.links.pieces;
        let mut found = Vec::new();
        if self.reason == Some(Reason::Pieces) {
            found.push(format!(
                "the photographs fall into pieces that share no points, as two captures do; {}; fit one of them with \
                 --group 1, or take photographs that connect them",
                self.groups()
            ));
        } else if let Some(apart) = pieces.get(1..).filter(|apart| !apart.is_empty() && self.reason.is_none())
        {
            let mut apart = apart.concat();
            apart.sort_unstable();
            found.push(format!(
                "{} hardly any points with the rest, so that their poses are doubtful: {}; take more photographs beside them",
                subject(apart.len(), "shares", "share"),
                self.listed(&apart)
            ));
        }
        for ([a, b], behind) in self.links.bridges.iter().filter(|bridge| bridge.1 >= HANGING) {
            found.push(format!(
                "{behind} photographs hang on the rest by the points that {} and {} share alone: take more photographs \
                 there",
                self.name(*a),
                self.name(*b)
            ));
        }
        found
    }

    fn sector(&self) -> Option<String> {
        let spread = self.spread.as_ref().filter(|spread| spread.inward && self.reason.is_none())?;
        let gap = spread.gaps.first().filter(|gap| gap.degrees >= WIDE_GAP)?;
        let [a, b] = gap.between.map(|view| self.name(view));
        Some(format!(
            "no photograph looks from a sector of {:.0}°, between {a} and {b}: what only shows from there is guessed; take \
             photographs there, or do not look from there",
            gap.degrees
        ))
    }

    fn pictures(&self) -> Vec<String> {
        let blurred = self.blurred();
        let mut found = Vec::new();
        if !blurred.is_empty() {
            found.push(format!(
                "{} blurred against {} neighbours: {}; take {} out where others show the same",
                subject(blurred.len(), "is", "are"),
                if blurred.len() == 1 { "its" } else { "their" },
                self.listed(&blurred),
                if blurred.len() == 1 { "it" } else { "them" }
            ));
        }
        if let Some([a, b]) = self.duplicates.first() {
            found.push(format!(
                "{} of photographs show the same picture, {} and {} first: keep one of each",
                count(self.duplicates.len(), "pair"),
                self.name(*a),
                self.name(*b)
            ));
        }
        if let Some(spread) = self.gains.as_ref().map(LogGains::spread).filter(|spread| *spread >= CALLED_FOR)
        {
            found.push(format!(
                "exposure differs between photographs (standard deviation {:.0} %): fit gives each a gain of its own; lock \
                 the exposure when you take them",
                100.0 * spread
            ));
        }
        found
    }
}

/// Returns the number of photographs with the verb `one` or `many`: `1 photograph is`, `2 photographs are`.
pub(super) fn subject(n: usize, one: &str, many: &str) -> String {
    format!("{} {}", count(n, "photograph"), if n == 1 { one } else { many })
}
