//! Results of all rounds, as a table or as JSON.

use std::fmt;

use serde::Serialize;

use crate::{Cost, Failure, RATES_HZ, Variant, median::median};

/// Results of the runs in all rounds.
#[derive(Serialize)]
pub(crate) struct Table {
    rounds: usize,
    seconds: f64,
    runs: Vec<Run>,
}

#[derive(Serialize)]
struct Run {
    round: usize,
    rate_hz: u32,
    variant: Variant,
    #[serde(flatten)]
    cost: Cost,
}

/// Row of the table. Each value is the median over the rounds, except that `lost` is the sum.
#[derive(Serialize)]
struct Row {
    rate_hz: u32,
    variant: Variant,
    #[serde(flatten)]
    cost: Cost,
    /// Ratio of the median latency to that of `zenoh` in the same round.
    ratio_p50: f64,
    /// Ratio of the CPU time to that of `zenoh` in the same round.
    ratio_cpu: f64,
}

impl Table {
    pub(crate) fn new(rounds: usize, seconds: f64) -> Self {
        Self { rounds, seconds, runs: Vec::new() }
    }

    pub(crate) fn add(&mut self, round: usize, rate_hz: u32, variant: Variant, cost: Cost) {
        self.runs.push(Run { round, rate_hz, variant, cost });
    }

    /// Returns the rows and the runs as a JSON object on one line.
    pub(crate) fn json(&self) -> Result<String, Failure> {
        #[derive(Serialize)]
        struct Report<'a> {
            rows: Vec<Row>,
            #[serde(flatten)]
            table: &'a Table,
        }
        Ok(serde_json::to_string(&Report { rows: self.rows(), table: self })?)
    }

    fn rows(&self) -> Vec<Row> {
        let variants = [Variant::Zenoh, Variant::Each, Variant::Batches, Variant::Carried, Variant::Tunnel];
        let conditions = RATES_HZ.into_iter().flat_map(|rate_hz| variants.map(|variant| (rate_hz, variant)));
        conditions.filter_map(|(rate_hz, variant)| self.row(rate_hz, variant)).collect()
    }

    fn row(&self, rate_hz: u32, variant: Variant) -> Option<Row> {
        let (costs, bare) = (self.costs(rate_hz, variant), self.costs(rate_hz, Variant::Zenoh));
        let over = |pick: fn(&Cost) -> f64| median(costs.iter().map(pick));
        let ratio =
            |pick: fn(&Cost) -> f64| median(costs.iter().zip(&bare).map(|(cost, bare)| pick(cost) / pick(bare)));
        let lost = costs.iter().map(|cost| cost.lost).sum();
        let cost = Cost {
            p50_us: over(|cost| cost.p50_us),
            p99_us: over(|cost| cost.p99_us),
            cpu_us: over(|cost| cost.cpu_us),
            lost,
        };
        let (ratio_p50, ratio_cpu) = (ratio(|cost| cost.p50_us), ratio(|cost| cost.cpu_us));
        (!costs.is_empty()).then_some(Row { rate_hz, variant, cost, ratio_p50, ratio_cpu })
    }

    /// Returns the results in order of rounds.
    fn costs(&self, rate_hz: u32, variant: Variant) -> Vec<Cost> {
        self.runs.iter().filter(|run| (run.rate_hz, run.variant) == (rate_hz, variant)).map(|run| run.cost).collect()
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "medians over {} rounds of {} s; lost: sum", self.rounds, self.seconds)?;
        writeln!(
            f,
            "| Hz | variant | p50 µs | p99 µs | CPU µs per sample | lost | p50 / zenoh | CPU / zenoh |\n| --- | --- | --- | --- | --- | --- | --- | --- |"
        )?;
        for Row { rate_hz, variant, cost: Cost { p50_us, p99_us, cpu_us, lost }, ratio_p50, ratio_cpu } in self.rows() {
            let name = format!("{variant:?}").to_lowercase();
            writeln!(
                f,
                "| {rate_hz} | {name} | {p50_us:.0} | {p99_us:.0} | {cpu_us:.1} | {lost} | {ratio_p50:.2} | {ratio_cpu:.2} |"
            )?;
        }
        Ok(())
    }
}
