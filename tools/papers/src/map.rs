//! A quantity over a plane, as colours.

use figures::{
    Area, Axis, Drawn,
    style::{TEXT, TITLE, number},
};
use plotters::{
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

/// Room for the scale of colours, pixels.
const SCALE_WIDTH: u32 = 110;

/// Values over a plane, row by row from the bottom.
#[derive(Debug)]
pub(crate) struct Map {
    pub(crate) title: String,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    /// What is coloured, and from where to where.
    pub(crate) of: Axis,
    pub(crate) columns: usize,
    pub(crate) values: Vec<f64>,
}

impl Map {
    pub(crate) fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn
    where
        B::ErrorType: 'static,
    {
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .margin_right(SCALE_WIDTH)
            .caption(&self.title, TITLE)
            .x_label_area_size(40)
            .y_label_area_size(66)
            .build_cartesian_2d(self.x.range.clone(), self.y.range.clone())?;
        let rows = self.values.len() / self.columns;
        let step = |axis: &Axis, of: usize| (axis.range.end - axis.range.start) / of as f64;
        let (wide, high) = (step(&self.x, self.columns), step(&self.y, rows));
        let cells = self.values.iter().enumerate().map(|(index, value)| {
            let left = self.x.range.start + (index % self.columns) as f64 * wide;
            let bottom = self.y.range.start + (index / self.columns) as f64 * high;
            Rectangle::new([(left, bottom), (left + wide, bottom + high)], self.color(*value).filled())
        });
        chart.draw_series(cells)?;
        chart
            .configure_mesh()
            .x_desc(self.x.label.as_ref())
            .y_desc(self.y.label.as_ref())
            .label_style(TEXT)
            .axis_desc_style(TEXT)
            .disable_mesh()
            .x_labels(9)
            .y_labels(9)
            .x_label_formatter(&number)
            .y_label_formatter(&number)
            .draw()?;
        self.scale(area)
    }

    /// Which value has which colour.
    fn scale<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn
    where
        B::ErrorType: 'static,
    {
        let (width, height) = area.dim_in_pixel();
        let (left, top, high) = (width as i32 - SCALE_WIDTH as i32 + 14, 60, height as i32 - 130);
        let at = |share: f64| self.of.range.start + share * (self.of.range.end - self.of.range.start);
        for row in 0..high {
            let value = at(1.0 - f64::from(row) / f64::from(high));
            let corners = [(left, top + row), (left + 18, top + row + 1)];
            area.draw(&Rectangle::new(corners, self.color(value).filled()))?;
        }
        let text = TEXT.into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
        for tick in 0..=4 {
            let share = f64::from(tick) / 4.0;
            let y = top + high - (share * f64::from(high)) as i32;
            area.draw(&Text::new(number(&at(share)), (left + 24, y), text.clone()))?;
        }
        area.draw(&Text::new(self.of.label.as_ref(), (left, top - 20), text))?;
        Ok(())
    }

    /// From blue through white to orange.
    fn color(&self, value: f64) -> RGBColor {
        let share = ((value - self.of.range.start) / (self.of.range.end - self.of.range.start)).clamp(0.0, 1.0);
        let (from, to, share) = if share < 0.5 {
            ([0, 90, 160], [248, 248, 248], 2.0 * share)
        } else {
            ([248, 248, 248], [200, 80, 0], 2.0 * share - 1.0)
        };
        let [r, g, b] = [0, 1, 2].map(|i| (f64::from(from[i]) + share * f64::from(to[i] - from[i])).round() as u8);
        RGBColor(r, g, b)
    }
}
