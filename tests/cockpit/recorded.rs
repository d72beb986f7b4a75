//! Page with a recorded flight.
use super::{
    browser::Page,
    page::{View, row},
};
use crate::common::{System, plumb, remote::free_port};

#[test]
fn recording_seeks_to_known_second() {
    let system = System::new("");
    let (flights, out) = (system.path("flights"), system.path("out.csv"));
    let record = ["--record", flights.to_str().unwrap(), "--out", out.to_str().unwrap(), "--for", "4s"];
    system.run(&record).assert_complete();
    let flight = std::fs::read_dir(&flights).unwrap().next().unwrap().unwrap().path();
    let listen = format!("127.0.0.1:{}", free_port());
    let view = View::start(plumb(&["view", flight.to_str().unwrap(), "--listen", &listen]));
    assert_eq!(view.address, format!("http://{listen}/"), "a recording takes no commands");
    if let Some(mut page) = Page::open(&view.address) {
        page.until("plumb.data.recording.length > 100");
        // The whole flight is drawn, and its time begins at 0.
        page.until("plumb.data.frames.length === plumb.data.recording.length && plumb.data.span_s > 3.5");
        page.until("Math.abs(plumb.data.window()[0] - plumb.data.frames[0].t) < 1e-6 && plumb.strips()?.[0]?.lines.length === 3");
        page.until("/^0\\.0\\d s$/.test(document.getElementById('time').textContent)");
        // Every frame has an error, although the recorder receives references late.
        let without_error =
            "plumb.data.frames.filter((frame) => Number.isNaN(frame.values[plumb.valueIndex('error_rad')]))";
        assert_eq!(page.eval(&format!("{without_error}.map((frame) => frame.t)")), serde_json::json!([]));
        // A large error at one time does not determine the scale of the error strip.
        page.eval("plumb.data.frames[40].values.set([0.5, 0.5], plumb.valueIndex('error_rad'))");
        page.until("plumb.strips()[2].most < 20 && Math.abs(plumb.strips()[2].cut_off - 28.65) < 0.01");
        page.until("[...document.querySelectorAll('.cut-off')].some((mark) => mark.textContent === '▲ up to 28.65°')");
        assert_eq!(page.eval("document.getElementById('lost-field').hidden"), true, "a recording has no losses");
        // A drag over the strips zooms to a time span. A double click shows the whole flight again.
        page.eval(
            "(() => {
                const canvas = document.querySelector('.strips > canvas'), { left, top, width } = canvas.getBoundingClientRect();
                const send = (kind, part) => canvas.dispatchEvent(new PointerEvent(kind, { pointerId: 1, clientX: left + 118 + part * (width - 126), clientY: top + 40, bubbles: true }));
                canvas.setPointerCapture = () => {};
                send('pointerdown', 0.5); send('pointermove', 0.7); send('pointerup', 0.7);
            })()",
        );
        page.until("Math.abs(plumb.data.span_s - 0.2 * plumb.data.maxSpan()) < 0.1");
        page.until("plumb.data.cursor >= plumb.data.window()[0] && plumb.data.cursor <= plumb.data.window()[1]");
        page.eval("document.querySelector('.strips > canvas').dispatchEvent(new MouseEvent('dblclick'))");
        page.until("plumb.data.span_s === plumb.data.maxSpan()");
        // Seeks to 2 s, the middle of the recording, by snapshot number.
        let place = 2.0 / 4.0 * page.number("plumb.data.recording.length");
        page.eval(&format!("plumb.seek({place})"));
        page.until(&format!("plumb.data.position === {} && plumb.drawn()?.quaternion", place.round()));
        page.until("Math.abs(plumb.data.shown().t - plumb.data.systemStatus.t_first_ns * 1e-9 - 2) < 0.1");
        let tick = page.number("plumb.data.shown().snapshot.attitude.header.tick") as u64;
        page.until("JSON.stringify(plumb.drawn().quaternion) === JSON.stringify(Object.values(plumb.data.shown().snapshot.attitude.quaternion))");
        let drawn: Vec<f64> = serde_json::from_value(page.eval("plumb.drawn().quaternion")).unwrap();
        assert_eq!(drawn, row(&out, tick)[1..5], "tick {tick}");
        page.shot("recording.png");
        for (key, view) in [("1", "fly"), ("2", "method"), ("3", "sensors"), ("4", "system"), ("1", "fly")] {
            page.key(key);
            page.until(&format!("plumb.view() === '{view}'"));
            page.assert_laid_out(view);
        }
        // The label of an event does not overlap the bar of an earlier event that has not yet
        // ended.
        page.eval(
            "(() => {
                const start = plumb.data.frames[0].t, event = { kind: 'FLAG', text: '', fault: true, reported_s: 0, number: -1, service: '', stage: '', tick: 0 };
                plumb.data.events.push({ ...event, label: 'long', t: start + 1, until: start + 2 }, { ...event, label: 'short', t: start + 1.5, until: start + 1.5 });
            })()",
        );
        page.until("['long', 'short'].every((label) => plumb.timeline().some((event) => event.label === label))");
        let events = page.eval("plumb.timeline().filter(({ row, text }) => row === 1 && text)");
        for (at, event) in events.as_array().unwrap().iter().enumerate() {
            let [from, to] = [&event["text"][0], &event["text"][1]].map(|px| px.as_f64().unwrap());
            for (other, bar) in events.as_array().unwrap().iter().enumerate().filter(|(other, _)| *other != at) {
                let [start, end] = [&bar["x"], &bar["until_x"]].map(|px| px.as_f64().unwrap());
                assert!(to < start || from > end, "{at} covers {other}: {events}");
            }
        }
        // Steps with the keyboard, then plays to the end.
        page.key("ArrowRight");
        page.until(&format!("plumb.data.position === {}", place.round() + 1.0));
        page.key(" ");
        page.until("plumb.data.position === plumb.data.recording.length - 1");
        page.assert_clean();
    }
    view.stop();
}
