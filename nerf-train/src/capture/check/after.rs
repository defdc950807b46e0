//! Checks of the capture after the fit: how well the field reproduces each training photograph.

use super::Diagnosis;
use super::found::subject;
use crate::data::cameras::bundle::median;
use crate::system::summary::Short;
use serde::Serialize;

/// Limits for a PSNR far below the median: lower by more than `.0` dB and by more than `.1` median absolute deviations.
const FAR_WORSE: (f64, f64) = (5.0, 6.0);
/// Difference between the mean PSNR of the best and of the worst group, dB. From this difference on, the poses of the
/// worst group are doubtful.
const DIFFERENT_DB: f64 = 3.0;
/// Median PSNR, dB, below which photographs without point tracks are reported as contradicting each other.
const LOW_DB: f64 = 22.0;
/// Minimum number of training steps before [`LOW_DB`] applies: the PSNR of a shorter fit may still be low.
const A_WHILE: u32 = 2000;

/// PSNR of a field on its training photographs, and findings from it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Fitted {
    pub train_psnr_db: Option<Short>,
    /// Groups of the diagnosis, each with its mean PSNR. If the diagnosis has no groups and the data have no point
    /// tracks, these are runs of consecutive photographs, split where the viewing direction jumps.
    pub train_groups: Vec<Group>,
    /// Names of the photographs whose PSNR is far below the median of all training photographs (`FAR_WORSE`).
    pub train_far_worse: Vec<String>,
    #[serde(skip)]
    findings: Vec<String>,
}

/// A group of training photographs and its mean PSNR.
#[derive(Clone, Debug, Serialize)]
pub struct Group {
    pub first: String,
    pub last: String,
    pub photographs: usize,
    pub psnr_db: Short,
}

impl Fitted {
    /// Judges a fit of `steps` steps. `photographs`: names and PSNR, dB. The result is empty if no PSNR is finite.
    pub fn of(diagnosis: &Diagnosis, photographs: &[(&str, f64)], steps: u32) -> Self {
        let finite = || photographs.iter().map(|(_, db)| *db).filter(|db| db.is_finite());
        let middle = median(finite());
        if middle.is_nan() {
            return Self::default();
        }
        let deviation = median(finite().map(|db| (db - middle).abs()));
        let limit = middle - FAR_WORSE.0.max(FAR_WORSE.1 * deviation);
        let worse: Vec<&(&str, f64)> = photographs.iter().filter(|(_, db)| *db < limit).collect();
        let named = if diagnosis.groups.is_empty() && !diagnosis.tracks {
            &diagnosis.runs
        } else {
            &diagnosis.groups
        };
        let groups: Vec<Group> = named.iter().filter_map(|names| Group::of(names, photographs)).collect();
        let mut fitted = Self {
            train_psnr_db: Some(Short(middle as f32)),
            train_far_worse: worse.iter().map(|(name, _)| (*name).to_owned()).collect(),
            train_groups: groups,
            findings: Vec::new(),
        };
        fitted.findings.push(fitted.figures(middle));
        if !worse.is_empty() {
            let shown: Vec<String> =
                worse.iter().take(6).map(|(name, db)| format!("{name} {db:.1} dB")).collect();
            fitted.findings.push(format!(
                "{} far worse than the rest, by a wrong pose or by something that moved: {}; fit without {}",
                subject(worse.len(), "is shown", "are shown"),
                shown.join(", "),
                if worse.len() == 1 { "it" } else { "them" }
            ));
        }
        fitted.findings.extend(fitted.doubt(diagnosis.tracks, middle, steps));
        fitted
    }

    pub fn lines(&self) -> impl Iterator<Item = &str> {
        self.findings.iter().map(String::as_str)
    }

    fn figures(&self, middle: f64) -> String {
        let one = |group: &Group| format!("{} to {} {:.1} dB", group.first, group.last, group.psnr_db.0);
        match self.train_groups.as_slice() {
            [] | [_] => format!("training photographs: median {middle:.1} dB"),
            groups => {
                let groups: Vec<String> = groups.iter().map(one).collect();
                format!("training photographs: median {middle:.1} dB; by group {}", groups.join(", "))
            }
        }
    }

    /// Returns a finding if the mean PSNR of the worst group is at least [`DIFFERENT_DB`] below that of the best group.
    /// Otherwise returns a finding if the median PSNR `middle`, dB, is below [`LOW_DB`]. This second test applies only
    /// to data without point tracks (`tracks`), after at least [`A_WHILE`] training steps (`steps`).
    fn doubt(&self, tracks: bool, middle: f64, steps: u32) -> Option<String> {
        let by_db = |a: &&Group, b: &&Group| a.psnr_db.0.total_cmp(&b.psnr_db.0);
        let (low, high) = (self.train_groups.iter().min_by(by_db)?, self.train_groups.iter().max_by(by_db)?);
        if f64::from(high.psnr_db.0 - low.psnr_db.0) >= DIFFERENT_DB {
            return Some(format!(
                "the photographs {} to {} are shown {:.1} dB worse than the best group: their poses are doubtful; find them \
                 again, or fit without these photographs",
                low.first,
                low.last,
                high.psnr_db.0 - low.psnr_db.0
            ));
        }
        (!tracks && steps >= A_WHILE && middle < LOW_DB).then(|| {
            format!(
                "even the photographs that were fitted stay at {middle:.1} dB: they contradict each other, by wrong poses, \
                 by what moved or by light that changed; find the poses again, from a model with its tracks"
            )
        })
    }
}

impl Group {
    fn of(names: &[String], photographs: &[(&str, f64)]) -> Option<Self> {
        let of = photographs.iter().filter(|(name, _)| names.iter().any(|known| known == name));
        let db: Vec<f64> = of.map(|(_, db)| *db).filter(|db| db.is_finite()).collect();
        let mean = db.iter().sum::<f64>() / db.len() as f64;
        (!db.is_empty()).then_some(Self {
            first: names.first()?.clone(),
            last: names.last()?.clone(),
            photographs: db.len(),
            psnr_db: Short(mean as f32),
        })
    }
}
