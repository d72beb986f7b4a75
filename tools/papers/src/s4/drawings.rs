//! Drawings of S4: axes, platform and the three block diagrams.

use attitude::Vector3;
use figures::style::{BLUE, GREEN, GREY, ORANGE};
use plotters::style::{BLACK, Color, RGBColor};

use crate::{
    block_diagram::{Arrow, Block, BlockDiagram},
    picture::{Figure, Panel, Part, Picture},
    scene::{Scene, Shape, arc, circle},
};

fn block(at: (f64, f64), size: (f64, f64), lines: &'static [&'static str]) -> Block {
    Block { at, size, lines }
}

fn arrow(path: &'static [(f64, f64)], label: &'static str) -> Arrow {
    Arrow { path, label }
}

fn diagram_part(name: &'static str, title: &str, caption: &str, size: (u32, u32), diagram: BlockDiagram) -> Part {
    Part {
        name,
        title: title.into(),
        caption: caption.into(),
        picture: Picture::Figure(Figure { size, columns: 1, panels: vec![Panel::BlockDiagram(diagram)] }),
    }
}

fn axis(to: Vector3<f64>, label: &str, color: RGBColor) -> Shape {
    Shape::Arrow { from: Vector3::zeros(), to, color, label: label.into() }
}

/// Returns figures 1 and 2.
pub(super) fn axes() -> Part {
    let level =
        || Shape::Line { points: circle(|cos, sin| Vector3::new(cos, sin, 0.0)), color: BLACK.mix(0.3), width: 1 };
    // Outline of a vehicle in body axes: fuselage, wings and tail.
    let outline = |points: &[(f64, f64)]| Shape::Line {
        points: points.iter().map(|(x, y)| Vector3::new(*x, *y, 0.0)).collect(),
        color: GREY.to_rgba(),
        width: 2,
    };
    let body = vec![
        outline(&[(0.0, 0.75), (0.1, 0.5), (0.1, -0.5), (0.0, -0.65), (-0.1, -0.5), (-0.1, 0.5), (0.0, 0.75)]),
        outline(&[(-0.75, 0.05), (0.75, 0.05), (0.75, 0.2), (-0.75, 0.2), (-0.75, 0.05)]),
        outline(&[(-0.25, -0.5), (0.25, -0.5)]),
        axis(Vector3::x(), "ξ, right", BLUE),
        axis(Vector3::y() * 1.1, "η, forward", BLUE),
        axis(Vector3::z() * 0.9, "ζ, up", BLUE),
    ];
    let (sin, cos) = 12f64.to_radians().sin_cos();
    let (z_sin, z_cos) = 35f64.to_radians().sin_cos();
    // Rotation by the azimuth of the platform, then by both misalignments, which are exaggerated.
    let right = Vector3::new(z_cos * cos, z_sin * cos, sin);
    let up = Vector3::new(-sin * z_cos, -sin * z_sin, cos) + Vector3::new(z_sin, -z_cos, 0.0) * 0.25;
    let up = (up - right * up.dot(&right)).normalize();
    let forward = up.cross(&right).normalize();
    let azimuth = arc(Vector3::x(), Vector3::y(), 35f64.to_radians(), 0.6);
    let platform = vec![
        level(),
        axis(Vector3::x(), "E", GREY),
        axis(Vector3::y(), "N", GREY),
        axis(Vector3::z(), "up", GREY),
        axis(right, "x_P", GREEN),
        axis(forward, "y_P", GREEN),
        axis(up, "z_P", GREEN),
        Shape::Line { points: azimuth, color: ORANGE.to_rgba(), width: 2 },
        Shape::Line { points: vec![Vector3::z() * 0.8, up * 0.8], color: ORANGE.to_rgba(), width: 2 },
        Shape::LegendEntry { color: ORANGE, label: "free azimuth, and tilt (exaggerated)".into() },
        Shape::LegendEntry { color: GREEN, label: "platform".into() },
        Shape::LegendEntry { color: GREY, label: "geographic frame".into() },
    ];
    let scene = |title: &str, azimuth_deg, shapes| {
        Panel::Scene(Scene { title: title.into(), azimuth_deg, elevation_deg: 28.0, half_extent: 1.3, shapes })
    };
    let panels = vec![
        scene("figure 1: body axes as used here", -50.0, body),
        scene("figure 2: platform and geographic frame", 60.0, platform),
    ];
    Part {
        name: "figure-1-2",
        title: "Figures 1 and 2: axes, and misalignment of the platform".into(),
        caption: "The platform is a horizontal frame with free azimuth. Levelling rotates it at the rate ω_c until its tilt is removed. Here it is the reference frame of (w, z), and C = Aᵀ.".into(),
        picture: Picture::Figure(Figure { size: (1100, 520), columns: 2, panels }),
    }
}

/// Returns figure 3.
pub(super) fn aided() -> Part {
    let diagram = BlockDiagram {
        title: "figure 3: with GNSS".into(),
        size: (12.0, 5.0),
        blocks: vec![
            block((2.4, 1.2), (3.0, 1.3), &["C' = C ω̂ − ω̂_c C", "H = atan2(C12, C22)"]),
            block((2.4, 3.8), (3.0, 1.3), &["f_P = C f", "rotated by H: fx, fy"]),
            block((6.3, 3.8), (2.6, 1.3), &["gx = fx − V H'", "gy = fy − V'"]),
            block((9.8, 2.5), (2.6, 1.6), &["ωx = −K gy", "ωy = K gx", "rotated by −H: ω_c"]),
            block((6.3, 2.0), (1.5, 0.8), &["receiver"]),
        ],
        arrows: vec![
            arrow(&[(0.1, 1.2), (0.9, 1.2)], "ω"),
            arrow(&[(0.1, 3.8), (0.9, 3.8)], "f"),
            arrow(&[(2.4, 1.85), (2.4, 3.15)], "C, H"),
            arrow(&[(3.9, 3.8), (5.0, 3.8)], "fx, fy"),
            arrow(&[(6.3, 2.4), (6.3, 3.15)], "V, V'"),
            arrow(&[(7.6, 3.8), (9.8, 3.8), (9.8, 3.3)], "gx, gy"),
            arrow(&[(9.8, 1.7), (9.8, 0.9), (3.9, 0.9)], "ω_c"),
        ],
    };
    diagram_part(
        "figure-3",
        "Figure 3: block diagram with GNSS correction",
        "(3), (4): the platform is levelled by the force minus the vehicle's acceleration, which is derived from GNSS. K g is the inverse of the time constant. Stage levelling while fixes are available, and P1 of levelling-unified.",
        (1000, 440),
        diagram,
    )
}

/// Returns figure 5.
pub(super) fn autonomous() -> Part {
    let diagram = BlockDiagram {
        title: "figure 5: without GNSS".into(),
        size: (12.0, 5.0),
        blocks: vec![
            block((2.4, 1.2), (3.0, 1.3), &["C' = C ω̂ − ω̂_c C", "H = atan2(C12, C22)"]),
            block((2.4, 3.8), (3.0, 1.3), &["f_P = C f"]),
            block((6.3, 3.8), (2.6, 1.3), &["low-pass", "of f_P,x and f_P,y"]),
            block((9.8, 2.5), (2.6, 1.6), &["ωx = −K f_P,y", "ωy = K f_P,x"]),
        ],
        arrows: vec![
            arrow(&[(0.1, 1.2), (0.9, 1.2)], "ω"),
            arrow(&[(0.1, 3.8), (0.9, 3.8)], "f"),
            arrow(&[(2.4, 1.85), (2.4, 3.15)], "C"),
            arrow(&[(3.9, 3.8), (5.0, 3.8)], "f_P"),
            arrow(&[(7.6, 3.8), (9.8, 3.8), (9.8, 3.3)], ""),
            arrow(&[(9.8, 1.7), (9.8, 0.9), (3.9, 0.9)], "ω_c"),
        ],
    };
    diagram_part(
        "figure-5",
        "Figure 5: block diagram without GNSS",
        "The low-pass filtered force replaces the force without the vehicle's acceleration. Time constants here: low-pass 20 s, levelling 60 s.",
        (1000, 440),
        diagram,
    )
}

/// Returns figure 7.
pub(super) fn unified() -> Part {
    let diagram = BlockDiagram {
        title: "figure 7: two platforms in parallel, selected by k".into(),
        size: (12.0, 6.0),
        blocks: vec![
            block((2.6, 1.2), (2.6, 1.2), &["platform P1", "figure 3"]),
            block((2.6, 4.8), (2.6, 1.2), &["platform P2", "figure 5"]),
            block((6.2, 0.8), (2.4, 1.0), &["complex course (5)"]),
            block((9.6, 1.6), (1.4, 0.9), &["· k"]),
            block((9.6, 4.4), (1.4, 0.9), &["· (1 − k)"]),
            block((11.2, 3.0), (0.7, 0.9), &["+"]),
            block((6.2, 3.0), (2.8, 1.0), &["k = 0 in a gap, else 1"]),
        ],
        arrows: vec![
            arrow(&[(0.1, 1.2), (1.3, 1.2)], "ω, f, V"),
            arrow(&[(0.1, 4.8), (1.3, 4.8)], "ω, f"),
            arrow(&[(3.9, 0.8), (5.0, 0.8)], "HΓ"),
            arrow(&[(7.4, 0.8), (9.6, 0.8), (9.6, 1.15)], "H"),
            arrow(&[(3.9, 1.6), (8.9, 1.6)], "roll, pitch"),
            arrow(&[(3.9, 4.6), (8.9, 4.6)], "roll, pitch, HΓ"),
            arrow(&[(7.6, 3.0), (9.6, 3.0), (9.6, 2.05)], "k"),
            arrow(&[(9.6, 3.0), (9.6, 3.95)], ""),
            arrow(&[(10.3, 1.6), (11.2, 1.6), (11.2, 2.55)], ""),
            arrow(&[(10.3, 4.4), (11.2, 4.4), (11.2, 3.45)], ""),
            arrow(&[(11.55, 3.0), (11.95, 3.0)], ""),
        ],
    };
    diagram_part(
        "figure-7",
        "Figure 7: block diagram of the unified scheme",
        "Stage levelling-unified. HΓ starts at an arbitrary direction of its platform. The offset is recomputed at each change of k, so the course is continuous. Roll and pitch jump by the difference between the platforms, which is flagged as `aligned`.",
        (1000, 480),
        diagram,
    )
}
