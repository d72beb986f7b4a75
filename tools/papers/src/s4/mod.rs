//! S4: orientation algorithm for a low-grade MEMS strapdown system, tried on a Mi-8 helicopter.

mod drawings;
mod runs;

use attitude::metrics::AngleError;
use figures::{
    Axis, Chart, Curve,
    style::{BLUE, GREEN, LineStyle, ORANGE, PURPLE, SKY},
};
use plotters::style::RGBColor;

use crate::{
    Progress,
    picture::{Figure, Panel, Part, Picture},
    table::Table,
};
use runs::{DURATION_S, SEEDS, STAGES, StageErrors, run_flights};
pub use runs::{GnssCoverage, SquaredErrors};

/// Number of simulation runs: one for each GNSS coverage and each seed.
pub(crate) const RUN_COUNT: u64 = GnssCoverage::ALL.len() as u64 * SEEDS;

/// Curve styles of the stages, in the order of `STAGES`. A curve that is covered by others is drawn
/// wider.
const STYLES: [(RGBColor, LineStyle); 4] =
    [(SKY, LineStyle::Wide), (PURPLE, LineStyle::Thick), (ORANGE, LineStyle::Thin), (BLUE, LineStyle::Thin)];

/// Description of the simulated data.
const DATA_NOTE: &str = "The flight data of the paper are not published. A simulated cruise of the same length replaces them: turns of 2 to 3 °/s for 20 to 60 s, gyro bias ±0.05 °/s and noise 0.05 °/s rms, accelerometer bias ±0.02 m/s² and noise 0.02 m/s² rms, velocity noise 0.05 m/s rms, velocity delay 0.2 s.";

/// Returns figures 1 to 7, the course figure and the tables.
pub(crate) fn parts(progress: &mut Progress<'_>) -> Vec<Part> {
    let [always, gaps, never] = GnssCoverage::ALL.map(|coverage| run_flights(coverage, || progress.step()));
    vec![
        drawings::axes(),
        drawings::aided(),
        errors(
            "figure-4",
            "Figure 4: signed errors with continuous GNSS",
            2.0,
            &always,
            "The paper shows pitch against a fibre-optic system in about 3,500 s of helicopter cruise, with roll and pitch RMS of 0.2° to 0.5°. levelling and levelling-unified have the same law here.",
        ),
        drawings::autonomous(),
        errors(
            "figure-6",
            "Figure 6: signed errors without GNSS",
            10.0,
            &never,
            "The paper: 0.3° to 1.0° RMS. An uncorrected gyro bias of 0.05 °/s causes 3° of tilt in a loop of 60 s. The figures of the paper need a better gyro, or corrections that it does not describe. levelling, levelling-unified and levelling-pi have the same law here, so their curves coincide.",
        ),
        drawings::unified(),
        errors(
            "figure-7-errors",
            "Figure 7: signed errors with a 60 s GNSS gap every 240 s",
            10.0,
            &gaps,
            "As published, the second platform provides the output in every gap. It carries the effect of the bias all the time, so roll and pitch jump at each edge of a gap by the difference between the platforms. A single attitude with both laws (levelling) departs from the aided level only slowly. With the bias estimated (levelling-pi, aided) a gap costs almost no accuracy.",
        ),
        course(&always, &gaps),
        table(&always, &gaps, &never),
        course_table(&always, &gaps),
    ]
}

fn time_axis() -> Axis {
    Axis::new("time, s", 0.0..DURATION_S)
}

/// Returns a curve that is broken where an angle wraps.
fn line(
    name: &str,
    color: RGBColor,
    style: LineStyle,
    samples: &[(f64, AngleError)],
    value: fn(&AngleError) -> f64,
) -> Curve {
    let values: Vec<_> = samples.iter().map(|(t_s, error)| (*t_s, value(error))).collect();
    Curve::over_time(name, color, style, &values, 180.0)
}

fn errors(name: &'static str, title: &str, range_deg: f64, flights: &[StageErrors], caption: &str) -> Part {
    let panel = |title: &str, label, value: fn(&AngleError) -> f64| {
        // The most accurate stage is drawn last, so that its curve is on top.
        let curves = STAGES
            .iter()
            .zip(STYLES)
            .zip(flights)
            .map(|((name, (color, style)), errors)| line(name, color, style, &errors.samples, value));
        Panel::Chart(Chart {
            title: title.into(),
            x: time_axis(),
            y: Axis::new(label, -range_deg..range_deg),
            curves: curves.collect(),
            has_legend: true,
        })
    };
    let panels = vec![
        panel("pitch", "pitch error, °", |error| error.pitch_deg),
        panel("roll", "roll error, °", |error| error.roll_deg),
    ];
    let rms: Vec<_> = STAGES
        .iter()
        .zip(flights)
        .map(|(name, errors)| {
            format!("{name} {} / {}", format_deg(errors.total().roll_deg()), format_deg(errors.total().pitch_deg()))
        })
        .collect();
    Part {
        name,
        title: title.into(),
        caption: format!(
            "{DATA_NOTE} {caption} Ours, roll / pitch RMS of the whole flight from 120 s on, {SEEDS} seeds: {}.",
            rms.join(", ")
        ),
        picture: Picture::Figure(Figure { size: (1100, 800), columns: 1, panels }),
    }
}

fn course(always: &[StageErrors], gaps: &[StageErrors]) -> Part {
    let panel = |title: &str, flights: &[StageErrors]| {
        let samples = |stage: usize| flights.get(stage).map_or(&[][..], |errors| &errors.samples);
        // The heading is positive clockwise, like the course.
        let curves = vec![
            line("levelling, track", SKY, LineStyle::Wide, samples(0), |error| error.course_deg),
            line("levelling-unified", PURPLE, LineStyle::Thick, samples(1), |error| -error.yaw_deg),
            line("levelling-pi, track", ORANGE, LineStyle::Thin, samples(2), |error| error.course_deg),
            line("aided", BLUE, LineStyle::Thin, samples(3), |error| -error.yaw_deg),
        ];
        Panel::Chart(Chart {
            title: title.into(),
            x: time_axis(),
            y: Axis::new("course error, °", -15.0..15.0),
            curves,
            has_legend: true,
        })
    };
    let levelling = always.first().map_or(&[][..], |errors| &errors.samples);
    // The gyroscopic course starts at an arbitrary direction, so only its change since the start is
    // an error.
    let start_deg = levelling.first().map_or(0.0, |(_, error)| error.yaw_deg);
    let gyroscopic: Vec<_> = levelling
        .iter()
        .map(|(t_s, error)| (*t_s, attitude::state::wrapped_rad((start_deg - error.yaw_deg).to_radians()).to_degrees()))
        .collect();
    let alone = Panel::Chart(Chart {
        title: "gyroscopic course alone".into(),
        x: time_axis(),
        y: Axis::new("course error, °", -180.0..180.0),
        curves: vec![Curve::over_time("levelling", GREEN, LineStyle::Thick, &gyroscopic, 180.0)],
        has_legend: true,
    });
    let panels = vec![
        panel("complex course (5), T = 50 s, continuous GNSS", always),
        panel("with a 60 s GNSS gap every 240 s", gaps),
        alone,
    ];
    Part {
        name: "course",
        title: "Complex course with the track, (5)".into(),
        caption: "H_k = H_{k−1} + ΔHΓ − h (H_{k−1} − H_track)/T. A gyro bias b about the vertical leaves an error T b, 2.5° for 0.05 °/s, and a gap of 60 s adds 3°. levelling and levelling-pi are followed by the stage track of the course slot. levelling-unified contains (5), and aided finds true north by itself. The gyroscopic course alone drifts by 175° in this time.".into(),
        picture: Picture::Figure(Figure { size: (1100, 1100), columns: 1, panels }),
    }
}

fn format_deg(deg: Option<f64>) -> String {
    deg.map_or("–".into(), |deg| format!("{deg:.3}"))
}

fn table(always: &[StageErrors], gaps: &[StageErrors], never: &[StageErrors]) -> Part {
    let paper = |name: &str, aided: &str, alone: &str| {
        let cells = [name, aided, aided, "–", "–", "–", "–", alone, alone];
        cells.iter().map(|cell| (*cell).into()).collect::<Vec<String>>()
    };
    let mut rows = vec![paper("paper, in flight", "0.2–0.5", "0.3–1.0")];
    for (stage, name) in STAGES.iter().enumerate() {
        let axes = |flights: &[StageErrors], pick: fn(&StageErrors) -> SquaredErrors| {
            let sums = flights.get(stage).map(pick).unwrap_or_default();
            [format_deg(sums.roll_deg()), format_deg(sums.pitch_deg())]
        };
        let cells = [
            axes(always, |errors| errors.aided),
            axes(gaps, |errors| errors.aided),
            axes(gaps, |errors| errors.autonomous),
            axes(never, |errors| errors.autonomous),
        ];
        rows.push([(*name).into()].into_iter().chain(cells.into_iter().flatten()).collect());
    }
    Part {
        name: "table-errors",
        title: "Table: RMS by axis, degrees".into(),
        caption: format!("{DATA_NOTE} {SEEDS} seeds, from 120 s on."),
        picture: Picture::Table(Table::new(
            &[
                "stage",
                "aided: roll",
                "pitch",
                "gaps, aided: roll",
                "pitch",
                "in gaps: roll",
                "pitch",
                "no GNSS: roll",
                "pitch",
            ],
            rows,
        )),
    }
}

fn course_table(always: &[StageErrors], gaps: &[StageErrors]) -> Part {
    let row = |(stage, name): (usize, &&str)| {
        let courses = |flights: &[StageErrors]| {
            let sums = flights.get(stage).map(StageErrors::total).unwrap_or_default();
            // The heading of `levelling` starts at an arbitrary direction and is not a course.
            let own = if stage == 0 { None } else { sums.heading_deg() };
            [format_deg(own), format_deg(sums.course_deg())]
        };
        [(*name).to_string()].into_iter().chain(courses(always)).chain(courses(gaps)).collect()
    };
    Part {
        name: "table-course",
        title: "Table: course RMS, degrees".into(),
        caption: "Heading of the stage itself, and course of the stage track behind it. Behind a heading that is already true, track corrects the remaining error.".into(),
        picture: Picture::Table(Table::new(
            &["stage", "aided: heading", "with track", "gaps: heading", "with track"],
            STAGES.iter().enumerate().map(row).collect(),
        )),
    }
}
