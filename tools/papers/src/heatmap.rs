//! Heatmap: a quantity over a plane, shown as colours.

use figures::{
    Area, Axis, DrawResult,
    style::{TEXT, TITLE, format_number},
};
use plotters::{
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

/// Width of the margin for the colour bar, pixels.
const COLOR_BAR_WIDTH: u32 = 110;

/// Values over a plane, row by row from the bottom.
#[derive(Debug)]
pub(crate) struct Heatmap {
    pub(crate) title: String,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    /// Label of the quantity, and its values at the two ends of the colour scale.
    pub(crate) value_axis: Axis,
    pub(crate) columns: usize,
    pub(crate) values: Vec<f64>,
}

impl Heatmap {
    pub(crate) fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .margin_right(COLOR_BAR_WIDTH)
            .caption(&self.title, TITLE)
            .x_label_area_size(40)
            .y_label_area_size(66)
            .build_cartesian_2d(self.x.range.clone(), self.y.range.clone())?;
        let rows = self.values.len() / self.columns;
        let cell_size = |axis: &Axis, count: usize| (axis.range.end - axis.range.start) / count as f64;
        let (cell_width, cell_height) = (cell_size(&self.x, self.columns), cell_size(&self.y, rows));
        let cells = self.values.iter().enumerate().map(|(index, value)| {
            let left = self.x.range.start + (index % self.columns) as f64 * cell_width;
            let bottom = self.y.range.start + (index / self.columns) as f64 * cell_height;
            Rectangle::new([(left, bottom), (left + cell_width, bottom + cell_height)], self.color(*value).filled())
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
            .x_label_formatter(&format_number)
            .y_label_formatter(&format_number)
            .draw()?;
        self.draw_color_bar(area)
    }

    /// Draws the colour bar to the right of the map.
    fn draw_color_bar<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let (width, height) = area.dim_in_pixel();
        let (left, top, bar_height) = (width as i32 - COLOR_BAR_WIDTH as i32 + 14, 60, height as i32 - 130);
        let range = &self.value_axis.range;
        let value_at = |share: f64| range.start + share * (range.end - range.start);
        for row in 0..bar_height {
            let value = value_at(1.0 - f64::from(row) / f64::from(bar_height));
            let corners = [(left, top + row), (left + 18, top + row + 1)];
            area.draw(&Rectangle::new(corners, self.color(value).filled()))?;
        }
        let text = TEXT.into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
        for tick in 0..=4 {
            let share = f64::from(tick) / 4.0;
            let y = top + bar_height - (share * f64::from(bar_height)) as i32;
            area.draw(&Text::new(format_number(&value_at(share)), (left + 24, y), text.clone()))?;
        }
        area.draw(&Text::new(self.value_axis.label.as_ref(), (left, top - 20), text))?;
        Ok(())
    }

    /// Returns the colour of a value: from blue through white to orange, clamped at both ends.
    fn color(&self, value: f64) -> RGBColor {
        let range = &self.value_axis.range;
        let share = ((value - range.start) / (range.end - range.start)).clamp(0.0, 1.0);
        let (from, to, share) = if share < 0.5 {
            ([0, 90, 160], [248, 248, 248], 2.0 * share)
        } else {
            ([248, 248, 248], [200, 80, 0], 2.0 * share - 1.0)
        };
        let [r, g, b] = [0, 1, 2].map(|i| (f64::from(from[i]) + share * f64::from(to[i] - from[i])).round() as u8);
        RGBColor(r, g, b)
    }
}
