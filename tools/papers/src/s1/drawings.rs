//! Drawings of S1: the two finite rotations, the stereographic projection and the block diagram of
//! the fusion.

use attitude::Vector3;
use figures::style::{BLUE, GREEN, GREY, ORANGE};
use plotters::style::{BLACK, Color, RGBColor};

use crate::{
    block_diagram::{Arrow, Block, BlockDiagram},
    picture::{Figure, Panel, Part, Picture},
    scene::{Scene, Shape, arc, circle},
};

const POLE: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);

/// Returns figures 1 to 3.
pub(super) fn parts() -> Vec<Part> {
    vec![rotations(), projection()]
}

/// Returns the unit sphere, the plane through its centre, and the axes.
pub(super) fn sphere() -> Vec<Shape> {
    let corners = [(-1.3, -1.3), (1.3, -1.3), (1.3, 1.3), (-1.3, 1.3), (-1.3, -1.3)];
    let line = |points, strength: f64| Shape::Line { points, color: BLACK.mix(strength), width: 1 };
    let view = (-65f64.to_radians()).sin_cos();
    // The outline of the sphere is the great circle perpendicular to the line of sight.
    let (sin, cos) = 24f64.to_radians().sin_cos();
    let right = Vector3::new(-view.0, view.1, 0.0);
    let up = Vector3::new(-sin * view.1, -sin * view.0, cos);
    let mut shapes = vec![
        line(corners.iter().map(|(u, v)| Vector3::new(*u, *v, 0.0)).collect(), 0.25),
        line(circle(|cos, sin| right * cos + up * sin), 0.6),
        line(circle(|cos, sin| Vector3::new(cos, sin, 0.0)), 0.3),
        line(circle(|cos, sin| Vector3::new(cos, 0.0, sin)), 0.15),
        line(circle(|cos, sin| Vector3::new(0.0, cos, sin)), 0.15),
    ];
    let axes = [(Vector3::x() * 1.45, "ξ', u"), (Vector3::y() * 1.45, "η', v"), (Vector3::z() * 1.35, "ζ'")];
    shapes.extend(axes.map(|(to, label)| Shape::Arrow {
        from: Vector3::zeros(),
        to,
        color: GREY,
        label: label.into(),
    }));
    shapes.push(Shape::Dots { points: vec![POLE], color: BLACK.to_rgba(), radius: 3 });
    shapes
}

fn axes<const N: usize>(
    tips: [Vector3<f64>; N],
    labels: [&str; N],
    color: RGBColor,
) -> impl Iterator<Item = Shape> + use<N> {
    tips.into_iter().zip(labels.map(String::from)).map(move |(to, label)| Shape::Arrow {
        from: Vector3::zeros(),
        to,
        color,
        label,
    })
}

fn rotations() -> Part {
    let (sin, cos) = 35f64.to_radians().sin_cos();
    let rotated = [Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0), Vector3::z()];
    let plane =
        || Shape::Line { points: circle(|cos, sin| Vector3::new(cos, sin, 0.0)), color: BLACK.mix(0.3), width: 1 };
    let arc_line = |points, color: RGBColor| Shape::Line { points, color: color.to_rgba(), width: 2 };
    let mut first = vec![plane()];
    first.extend(axes([Vector3::x(), Vector3::y(), Vector3::z() * 1.15], ["ξ0", "η0", "ζ0, ζ'"], GREY));
    first.extend(axes([rotated[0], rotated[1], Vector3::z()], ["ξ'", "η'", ""], BLUE));
    first.push(arc_line(arc(Vector3::x(), Vector3::y(), 35f64.to_radians(), 0.55), ORANGE));
    first.push(Shape::Text { at: Vector3::new(0.68, 0.22, 0.0), text: "z".into() });
    // Rotation by 40° about a horizontal axis e.
    let e = (rotated[0] * 0.8 + rotated[1] * 0.6).normalize();
    let (tilt_sin, tilt_cos) = 40f64.to_radians().sin_cos();
    let tilt = |axis: Vector3<f64>| axis * tilt_cos + e.cross(&axis) * tilt_sin + e * (e.dot(&axis) * (1.0 - tilt_cos));
    let mut second = vec![plane()];
    second.extend(axes([rotated[0], rotated[1], Vector3::z()], ["ξ'", "η'", "ζ'"], BLUE));
    second.extend(axes(rotated.map(tilt), ["ξ", "η", "ζ"], GREEN));
    second.extend(axes([e * 1.25], ["e"], ORANGE));
    second.push(arc_line(arc(Vector3::z(), e.cross(&Vector3::z()), 40f64.to_radians(), 0.6), ORANGE));
    second.push(Shape::Text { at: (Vector3::z() + tilt(Vector3::z())).normalize() * 0.72, text: "δ".into() });
    let scene = |title: &str, shapes| {
        Panel::Scene(Scene { title: title.into(), azimuth_deg: 62.0, elevation_deg: 28.0, half_extent: 1.3, shapes })
    };
    let panels = vec![
        scene("figure 1: rotation by z about the vertical", first),
        scene("figure 2: rotation by δ about the horizontal axis e", second),
    ];
    Part {
        name: "figure-1-2",
        title: "Figures 1 and 2: the two finite rotations".into(),
        caption: "The attitude is reached by a rotation z about ζ0, followed by a rotation δ about an axis e in the horizontal plane: A = A(w) A(z), (1), (7), (15).".into(),
        picture: Picture::Figure(Figure { size: (1100, 520), columns: 2, panels }),
    }
}

fn projection() -> Part {
    let up: Vector3<f64> = Vector3::new(0.55, 0.35, 0.0);
    let up = Vector3::new(up.x, up.y, (1.0 - up.norm_squared()).sqrt());
    let w = Vector3::new(up.x, up.y, 0.0) / (1.0 + up.z);
    let mut shapes = sphere();
    shapes.extend([
        Shape::Line { points: vec![POLE, up], color: ORANGE.to_rgba(), width: 2 },
        Shape::Arrow { from: Vector3::zeros(), to: up, color: BLUE, label: String::new() },
        Shape::Dots { points: vec![up], color: BLUE.to_rgba(), radius: 5 },
        Shape::Dots { points: vec![w], color: ORANGE.to_rgba(), radius: 5 },
        Shape::Text { at: up * 1.14, text: "k'' (a, b, c)".into() },
        Shape::Text { at: w + Vector3::new(0.22, 0.12, 0.0), text: "w".into() },
        Shape::Text { at: POLE * 1.12, text: "pole −ζ'".into() },
    ]);
    let scene = Scene {
        title: "w = (a + jb) / (1 + c)".into(),
        azimuth_deg: -65.0,
        elevation_deg: 24.0,
        half_extent: 1.55,
        shapes,
    };
    Part {
        name: "figure-3",
        title: "Figure 3: the tip of k'' on the unit sphere and its stereographic image w".into(),
        caption: "The ray from the pole −ζ' through the tip of k'' meets the plane at w: (11), (12).".into(),
        picture: Picture::Figure(Figure { size: (620, 600), columns: 1, panels: vec![Panel::Scene(scene)] }),
    }
}

/// Returns figure 9 with the slots that implement it.
pub(super) fn fusion() -> Part {
    let block = |at, size, lines| Block { at, size, lines };
    let arrow = |path, label| Arrow { path, label };
    let diagram = BlockDiagram {
        title: "figure 9 and the slots that implement it".into(),
        size: (12.0, 5.0),
        blocks: vec![
            block((2.2, 1.2), (2.4, 1.4), &["slot gyro", "(18)–(20)"]),
            block((2.2, 3.8), (2.4, 1.4), &["slot accel", "(27), (28)"]),
            block((6.0, 1.2), (2.4, 1.4), &["HPF", "Ts / (Ts + 1)"]),
            block((6.0, 3.8), (2.4, 1.4), &["LPF", "1 / (Ts + 1)"]),
            block((8.9, 2.5), (1.0, 0.9), &["+"]),
            block((11.0, 2.5), (1.7, 1.2), &["slot course", "(23)–(25)"]),
        ],
        arrows: vec![
            arrow(&[(0.1, 1.2), (1.0, 1.2)], "ω"),
            arrow(&[(0.1, 3.8), (1.0, 3.8)], "f"),
            arrow(&[(3.4, 1.2), (4.8, 1.2)], "w, z"),
            arrow(&[(3.4, 3.8), (4.8, 3.8)], "w_a"),
            arrow(&[(7.2, 1.2), (8.9, 1.2), (8.9, 2.05)], "HPF(w)"),
            arrow(&[(7.2, 3.8), (8.9, 3.8), (8.9, 2.95)], "LPF(w_a)"),
            arrow(&[(9.4, 2.5), (10.15, 2.5)], "w_c"),
        ],
    };
    Part {
        name: "figure-9",
        title: "Figure 9: block diagram of the fusion".into(),
        caption: "T = 1 s. As published, the gyro channel integrates in open loop (stage wz-open of the fuser slot). With the loop closed, the exact step is applied to w_c itself (stage wz-closed).".into(),
        picture: Picture::Figure(Figure { size: (1000, 420), columns: 1, panels: vec![Panel::BlockDiagram(diagram)] }),
    }
}
