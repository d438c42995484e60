//! Rows put together: the same arm and take over scenes and seeds.

use guard4d_engine::base::ledger::Ledger;

use super::found::Found;
use super::plan::{Cell, Machine};
use super::row::Row;
use crate::table::Table;

/// What a sub-study has measured so far.
pub(super) struct Findings {
    found: Vec<Found>,
}

/// A figure of a row.
pub(super) type Figure = fn(&Row) -> Option<f64>;

/// Rows that differ in scene and seed.
pub(super) struct Group<'a> {
    pub(super) arm: &'a str,
    pub(super) take: &'a str,
    pub(super) rows: Vec<&'a Row>,
}

impl Findings {
    /// The rows of these cells that the ledger has.
    pub(super) fn gather(cells: &[Cell], ledger: &Ledger<Row>, machine: &Machine) -> Self {
        let mut found = Vec::new();
        for cell in cells {
            let id = cell.id(machine);
            let rows = cell.arm.takes.iter().filter_map(|take| Row::newest(ledger, &id, &take.to_string()));
            found.extend(rows.map(|row| Found { arm: cell.arm.name.clone(), row: row.clone() }));
        }
        Self { found }
    }

    /// Rows that were kept.
    pub(super) fn of(found: Vec<Found>) -> Self {
        Self { found }
    }

    /// All rows.
    pub(super) fn rows(&self) -> &[Found] {
        &self.found
    }

    /// Scenes in the order of their rows.
    pub(super) fn scenes(&self) -> Vec<&str> {
        let mut scenes: Vec<&str> = Vec::new();
        for Found { row, .. } in &self.found {
            if !scenes.contains(&row.scene.as_str()) {
                scenes.push(&row.scene);
            }
        }
        scenes
    }

    /// Arms and takes, over all scenes.
    pub(super) fn groups(&self) -> Vec<Group<'_>> {
        self.groups_where(|_| true)
    }

    /// Arms and takes over the rows that a condition holds for.
    pub(super) fn groups_where(&self, fits: impl Fn(&Row) -> bool) -> Vec<Group<'_>> {
        let mut groups: Vec<Group<'_>> = Vec::new();
        for Found { arm, row } in self.found.iter().filter(|found| fits(&found.row)) {
            match groups.iter_mut().find(|group| group.arm == arm && group.take == row.take) {
                Some(group) => group.rows.push(row),
                None => groups.push(Group { arm, take: &row.take, rows: vec![row] }),
            }
        }
        groups
    }
}

impl Group<'_> {
    /// Finite values of a figure.
    pub(super) fn values(&self, figure: Figure) -> Vec<f64> {
        self.rows.iter().filter_map(|row| figure(row)).filter(|v| v.is_finite()).collect()
    }

    /// Mean, least and greatest.
    pub(super) fn spread(&self, figure: Figure) -> Option<[f64; 3]> {
        let values = self.values(figure);
        let least = values.iter().copied().reduce(f64::min)?;
        let most = values.iter().copied().reduce(f64::max)?;
        Some([values.iter().sum::<f64>() / values.len() as f64, least, most])
    }

    /// Mean.
    pub(super) fn mean(&self, figure: Figure) -> Option<f64> {
        self.spread(figure).map(|[mean, ..]| mean)
    }

    /// Mean with so many decimals; nothing where nothing was measured.
    pub(super) fn decimals(&self, figure: Figure, digits: usize) -> String {
        self.mean(figure).map(|mean| format!("{mean:.digits$}")).unwrap_or_default()
    }

    /// Mean in percent.
    pub(super) fn percent(&self, figure: Figure) -> String {
        self.mean(figure).map(|mean| format!("{:.1}", 100.0 * mean)).unwrap_or_default()
    }

    /// Mean in percent, with the range if there is one.
    pub(super) fn percent_range(&self, figure: Figure) -> String {
        match self.spread(figure).map(|three| three.map(|v| 100.0 * v)) {
            Some([mean, least, most]) if least < most => format!("{mean:.1} ({least:.1} to {most:.1})"),
            Some([mean, ..]) => format!("{mean:.1}"),
            None => String::new(),
        }
    }

    /// Mean in percent, and in how many rows it kept to the band of chance.
    pub(super) fn control(&self, figure: Figure, in_band: fn(&Row) -> Option<bool>) -> String {
        let flags: Vec<bool> = self.rows.iter().filter_map(|row| in_band(row)).collect();
        if flags.is_empty() {
            return String::new();
        }
        format!("{} ({} of {} in band)", self.percent(figure), flags.iter().filter(|f| **f).count(), flags.len())
    }

    /// The worst p-value by some test.
    pub(super) fn worst_p(&self, figure: Figure) -> String {
        let worst = self.values(figure).into_iter().reduce(f64::max);
        worst.map_or_else(|| "none".to_owned(), |p| format!("{p:.1e}"))
    }

    /// How many rows `verify` would accept.
    pub(super) fn present(&self) -> String {
        let present = self.rows.iter().filter(|row| row.verdict == "present").count();
        format!("{present} of {}", self.rows.len())
    }

    /// Why rows have no reading.
    pub(super) fn errors(&self) -> String {
        self.verdicts(|row| &row.error)
    }

    /// What rows say in words, each of it once.
    pub(super) fn verdicts(&self, words: fn(&Row) -> &str) -> String {
        let mut said: Vec<&str> = Vec::new();
        for row in &self.rows {
            let words = words(row);
            if !words.is_empty() && !said.contains(&words) {
                said.push(words);
            }
        }
        said.join("; ")
    }
}

/// A column: its name, and its cell for a group.
pub(super) type Column = (&'static str, fn(&Group<'_>) -> String);

/// Columns that most tables have.
pub(super) const ARM: Column = ("arm", |g| g.arm.to_owned());
pub(super) const TAKE: Column = ("film", |g| g.take.to_owned());
pub(super) const ROWS: Column = ("embeddings", |g| g.rows.len().to_string());
pub(super) const MARKED: Column = ("bits right, %", |g| g.percent_range(|r| r.marked));
pub(super) const FRAMES: Column = ("frame by frame, %", |g| g.percent(|r| r.frames));
pub(super) const EXACT: Column = ("clips without a wrong bit, %", |g| g.percent(|r| r.exact));
pub(super) const PROVEN: Column = ("clips that prove it alone, %", |g| g.percent(|r| r.proven));
pub(super) const PSNR: Column = ("PSNR, dB", |g| g.decimals(|r| r.psnr_db, 2));
pub(super) const OBJECT: Column = ("PSNR of the object, dB", |g| g.decimals(|r| r.object_psnr_db, 2));
pub(super) const COLOUR: Column = ("CIEDE2000 of the object", |g| g.decimals(|r| r.colour_mean, 2));
pub(super) const COLOUR_P95: Column = ("the same, one pixel in twenty above", |g| g.decimals(|r| r.colour_p95, 2));
pub(super) const SSIM: Column = ("SSIM", |g| g.decimals(|r| r.ssim, 4));
pub(super) const LPIPS: Column = ("LPIPS", |g| g.decimals(|r| r.lpips, 4));
pub(super) const CLEAN: Column = ("clean clips, %", |g| g.control(|r| r.clean, |r| r.clean_in_band));
pub(super) const NOISY: Column = ("noisy clips, %", |g| g.control(|r| r.noisy, |r| r.noisy_in_band));
pub(super) const OTHERS: Column = ("other scenes, %", |g| g.control(|r| r.other_scenes, |r| r.other_scenes_in_band));
pub(super) const P_VALUE: Column = ("worst p-value", |g| g.worst_p(|r| r.p_soft));
pub(super) const P_MATCHES: Column = ("worst p-value of the matches", |g| g.worst_p(|r| r.p_value));
pub(super) const PRESENT: Column = ("verify: present", |g| g.present());
pub(super) const SECONDS: Column = ("seconds", |g| g.decimals(|r| r.wall_s, 1));
pub(super) const CPU_SECONDS: Column = ("CPU seconds", |g| g.decimals(|r| r.cpu_s, 1));
pub(super) const STEPS: Column = ("steps", |g| g.decimals(|r| r.steps.map(|steps| steps as f64), 0));
pub(super) const PEAK: Column = ("peak MiB", |g| g.decimals(|r| r.peak_mib, 0));
pub(super) const ERRORS: Column = ("failed because", |g| g.errors());

/// A table with a line per group.
pub(super) fn table(title: &str, note: &str, columns: &[Column], groups: &[Group<'_>]) -> Table {
    Table {
        title: title.to_owned(),
        note: note.to_owned(),
        head: columns.iter().map(|(name, _)| (*name).to_owned()).collect(),
        rows: groups.iter().map(|group| columns.iter().map(|(_, cell)| cell(group)).collect()).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_say_mean_and_range() {
        let row = |marked, verdict: &str| Row { marked, verdict: verdict.to_owned(), ..Row::default() };
        let rows = [row(Some(0.5), "present"), row(Some(1.0), "absent"), row(None, "")];
        let group = Group { arm: "a", take: "plain", rows: rows.iter().collect() };
        assert_eq!(group.percent_range(|r| r.marked), "75.0 (50.0 to 100.0)", "what was measured");
        assert_eq!(group.percent_range(|r| r.clean), "", "what was not");
        assert_eq!(group.present(), "1 of 3", "verdicts");
        assert_eq!(group.worst_p(|r| r.p_value), "none", "no p-value is no p-value of 0");
    }
}
