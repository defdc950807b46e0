//! Groups of photographs with consistent poses, found from pairs of photographs that agree or contradict each other.

use super::pairs::Pair;
use std::collections::{BTreeMap, BTreeSet};

/// Threshold on [`Pair::different`]. In clustering, a pair of photographs with a value below the threshold counts for
/// merging the two; a pair with a value above it counts against merging.
const UNDECIDED: f32 = 0.35;
/// Divisor for small sets of photographs: a small set has at most 1 / `FEW` of all photographs, or at most two.
const FEW: usize = 10;
/// Minimum number of contradicting pairs that make a photograph an outlier, or that keep two groups separate.
const CERTAIN: usize = 3;
/// Minimum fraction of contradicting pairs among compared pairs, at which photographs of rejected clusters may form a
/// last group. The rejected clusters must also hold more than [`few`] photographs.
const TORN: f32 = 0.1;

/// Groups of photographs, and outliers. Poses agree within each group; outliers agree with no group.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Groups {
    /// Indices of the photographs of each group; one group if no photographs contradict each other.
    pub groups: Vec<Vec<usize>>,
    /// Indices of the few photographs that contradict the other photographs.
    pub outliers: Vec<usize>,
}

pub(super) fn few(count: usize) -> usize {
    (count / FEW).max(2)
}

/// Clusters photographs: repeatedly merges the two clusters with the smallest mean [`Pair::different`] between them,
/// while that mean is below [`UNDECIDED`]. Returns a label for each photograph: the smallest index in its cluster.
fn clusters(count: usize, pairs: &[Pair]) -> Vec<usize> {
    let mut label: Vec<usize> = (0..count).collect();
    let weighted = pairs.iter().map(|pair| (pair.views, (UNDECIDED - pair.different, 1.0f32)));
    let mut links: BTreeMap<[usize; 2], (f32, f32)> = weighted.collect();
    let mean = |&(sum, number): &(f32, f32)| sum / number;
    while let Some((&[kept, merged], _)) =
        links.iter().filter(|(_, link)| mean(link) > 0.0).max_by(|a, b| mean(a.1).total_cmp(&mean(b.1)))
    {
        links.remove(&[kept, merged]);
        label.iter_mut().filter(|label| **label == merged).for_each(|label| *label = kept);
        let moved: Vec<_> = links.keys().filter(|link| link.contains(&merged)).copied().collect();
        for link in moved {
            let other = if link[0] == merged { link[1] } else { link[0] };
            let (sum, number) = links.remove(&link).unwrap_or_default();
            let link = links.entry([kept.min(other), kept.max(other)]).or_default();
            *link = (link.0 + sum, link.1 + number);
        }
    }
    label
}

/// Returns the number of agreeing pairs and of contradicting pairs, among the pairs whose indices `which` accepts.
fn count(pairs: &[Pair], which: impl Fn([usize; 2]) -> bool) -> (usize, usize) {
    let chosen = pairs.iter().filter(|pair| which(pair.views));
    chosen.fold((0, 0), |(good, bad), pair| {
        (good + usize::from(pair.agrees()), bad + usize::from(pair.contradicts()))
    })
}

/// Returns the labels of rejected clusters. Only small clusters ([`FEW`]) are rejected, in two passes. The first pass
/// rejects clusters with more contradicting than agreeing pairs, one at a time, largest fraction of contradicting pairs
/// first. After each rejection, the pairs that contain a photograph of the rejected cluster are ignored. The second
/// pass considers all pairs again, and rejects clusters that have contradicting pairs but no agreeing pair.
fn rejected(label: &[usize], pairs: &[Pair]) -> BTreeSet<usize> {
    let mut size: BTreeMap<usize, usize> = BTreeMap::new();
    label.iter().for_each(|label| *size.entry(*label).or_default() += 1);
    let small: Vec<usize> = size.into_iter().filter(|s| s.1 <= few(label.len())).map(|s| s.0).collect();
    let mut rejected = BTreeSet::new();
    let counts = |rejected: &BTreeSet<usize>| {
        let mut counts = vec![(0, 0); label.len()];
        for pair in pairs {
            let touched = BTreeSet::from(pair.views.map(|view| label[view]));
            for &cluster in touched.iter().filter(|_| touched.is_disjoint(rejected)) {
                let (good, bad): &mut (usize, usize) = &mut counts[cluster];
                *good += usize::from(pair.agrees());
                *bad += usize::from(pair.contradicts());
            }
        }
        counts
    };
    let all = counts(&rejected);
    loop {
        let counts = counts(&rejected);
        // Compares fractions of contradicting pairs without a division.
        let share = |a: (usize, usize), b: (usize, usize)| (a.1 * (b.0 + b.1)).cmp(&(b.1 * (a.0 + a.1)));
        let worst = small.iter().filter(|cluster| counts[**cluster].1 > counts[**cluster].0);
        let worst =
            worst.max_by(|a, b| share(counts[**a], counts[**b]).then(counts[**a].1.cmp(&counts[**b].1)));
        let Some(&worst) = worst else { break };
        rejected.insert(worst);
    }
    rejected.extend(small.into_iter().filter(|&cluster| all[cluster].0 == 0 && all[cluster].1 > 0));
    rejected
}

impl Groups {
    /// Divides the photographs into groups. `photographs`: number of photographs; `pairs`: all compared pairs.
    pub fn of(photographs: usize, pairs: &[Pair]) -> Self {
        let label = clusters(photographs, pairs);
        let rejected = rejected(&label, pairs);
        let mut members: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (view, label) in label.iter().enumerate().filter(|(_, label)| !rejected.contains(label)) {
            members.entry(*label).or_default().push(view);
        }
        let mut clusters: Vec<Vec<usize>> = members.into_values().collect();
        // The sort is stable: among clusters of equal size, the one with the first name comes first.
        clusters.sort_by_key(|cluster| std::cmp::Reverse(cluster.len()));
        let mut group: Vec<Option<usize>> = vec![None; photographs];
        let mut groups = 0;
        for cluster in clusters {
            if cluster.iter().all(|&v| pairs.iter().all(|pair| !pair.views.contains(&v))) {
                continue;
            }
            let inside = |view: usize| cluster.binary_search(&view).is_ok();
            let between = |of: usize| {
                count(pairs, |[a, b]| inside(a) && group[b] == Some(of) || inside(b) && group[a] == Some(of))
            };
            let counts: Vec<(usize, usize)> = (0..groups).map(between).collect();
            let possible = counts.iter().enumerate().filter(|(_, (good, bad))| *bad < CERTAIN || bad <= good);
            let best = possible.max_by_key(|(index, (good, _))| (*good, std::cmp::Reverse(*index)));
            let chosen = best.map_or(groups, |(index, _)| index);
            groups = groups.max(chosen + 1);
            cluster.iter().for_each(|&view| group[view] = Some(chosen));
        }
        let contradict: Vec<usize> = (0..photographs).filter(|&v| rejected.contains(&label[v])).collect();
        Self::named(group, groups, contradict, pairs)
    }

    /// Makes the final groups and the outliers.
    ///
    /// `group`: index of each photograph's group, below `groups`; `None` if the photograph is in `contradict` or in no
    /// pair. A photograph in no pair joins the previous one's group. `contradict`: photographs of rejected clusters.
    ///
    /// Photographs of rejected clusters, and photographs of small groups other than the first group, are doubtful. If
    /// there are many photographs of rejected clusters ([`FEW`], [`TORN`]), all doubtful photographs form a last group.
    /// Otherwise, each doubtful photograph becomes an outlier if it is in at least [`CERTAIN`] contradicting pairs, and
    /// joins the largest group if it is in fewer.
    fn named(
        mut group: Vec<Option<usize>>,
        groups: usize,
        mut contradict: Vec<usize>,
        pairs: &[Pair],
    ) -> Self {
        let all = group.len();
        let torn = count(pairs, |_| true).1 as f32 >= TORN * pairs.len() as f32;
        let many = contradict.len() > few(all) && torn;
        contradict.iter().for_each(|&view| group[view] = Some(groups));
        let mut last = Some(0);
        for of in &mut group {
            *of = of.or(last.filter(|&last| last < groups || many)).or(Some(0));
            last = *of;
        }
        let members = |of: usize| (0..all).filter(|&view| group[view] == Some(of)).collect::<Vec<_>>();
        let certain = |&view: &usize| count(pairs, |views| views.contains(&view)).1 >= CERTAIN;
        let (mut large, mut outliers): (Vec<_>, Vec<_>) = (Vec::new(), Vec::new());
        for of in 0..groups.max(1) {
            match members(of) {
                small if of > 0 && small.len() <= few(all) => contradict.extend(small),
                members => large.push(members),
            }
        }
        large.sort_by_key(|group| std::cmp::Reverse(group.len()));
        if many {
            // Photographs of the last group may contradict each other.
            let is_last = |view: &usize| group[*view] == Some(groups) || contradict.contains(view);
            large.push((0..all).filter(is_last).collect());
        } else {
            let (out, back): (Vec<_>, Vec<_>) = contradict.into_iter().partition(certain);
            outliers.extend(out);
            large[0].extend(back);
            large[0].sort_unstable();
        }
        outliers.sort_unstable();
        Self { groups: large, outliers }
    }
}
