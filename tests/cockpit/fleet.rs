//! Page with remote vehicles.
use super::{
    browser::Page,
    page::{View, row},
};
use crate::common::{
    System, plumb,
    remote::{endpoint, free_port, gateway},
    site::{Site, listening_vehicle},
    wait_for,
};

fn vehicle(name: &str, more: &str) -> System {
    let services = "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"course\", \"gateway\"]";
    let port = free_port();
    System::new(&format!("{services}\ngateway.listen = [\"tcp/127.0.0.1:{port}\"]\ngateway.vehicle = {name:?}\n{more}"))
}

fn view(system: &System, arguments: &[&str]) -> View {
    let mut command = plumb(&["view", "--listen", &format!("127.0.0.1:{}", free_port()), "--remote"]);
    command.args(arguments).env("XDG_STATE_HOME", system.path("")).env_remove("STATE_DIRECTORY");
    View::start(command)
}

#[test]
fn all_vehicles_are_listed_and_selected_one_is_shown() {
    let (boat, drone) = (vehicle("boat", ""), vehicle("drone", "[output]\nframe = \"ned-frd\"\n"));
    let out = drone.path("out.csv");
    let (boat_runs, drone_runs) = (boat.start(&[]), drone.start(&["--out", out.to_str().unwrap()]));
    let endpoints = [endpoint(&boat), endpoint(&drone)];
    let view = view(&boat, &["--connect", &endpoints[0], "--connect", &endpoints[1]]);
    let Some(mut page) = Page::open(&view.address) else { return };
    page.until("plumb.view() === 'fleet' && plumb.drawn()?.vehicles?.length === 2");
    page.until("plumb.drawn().vehicles.every(({ old, quaternion, stage, lost_ticks }) => !old && quaternion && stage === 'multiple-model' && lost_ticks === 0)");
    page.assert_laid_out("fleet");
    page.shot("fleet-1280.png");
    page.click("[data-vehicle=drone]");
    page.until("plumb.view() === 'fly' && plumb.state().kind === 'live' && document.getElementById('system').textContent === 'drone'");
    page.key(" ");
    page.until("document.getElementById('state').textContent === 'paused' && plumb.drawn()?.quaternion");
    let tick = page.number("plumb.data.shown().snapshot.attitude.header.tick") as u64;
    let drawn: Vec<f64> = serde_json::from_value(page.eval("plumb.drawn().quaternion")).unwrap();
    page.shot("fleet-chosen.png");
    page.key("4");
    page.until("plumb.drawn()?.services?.some(([service, state]) => service === 'fuser' && state === 'running')");
    assert_eq!(page.eval("document.getElementById('swap').disabled"), true, "a plain endpoint accepts no commands");

    // After the system of a vehicle has ended, the vehicle stays in the list and is marked as old.
    boat_runs.interrupt();
    boat_runs.wait().assert_complete();
    page.key("5");
    page.until("plumb.drawn()?.vehicles?.some(({ vehicle, old }) => vehicle === 'boat' && old)");
    page.until("plumb.drawn().vehicles.some(({ vehicle, old }) => vehicle === 'drone' && !old)");
    page.shot("fleet-gone.png");
    // Fifty vehicles, one without a connection, are summarised, filtered and sorted.
    page.eval(
        "(() => {
            const [line] = plumb.data.systemStatus.vehicles.filter(({ vehicle }) => vehicle === 'drone');
            const vehicles = [...Array(50).keys()].map((at) => ({ ...line, vehicle: `drone-${at}`, alive: at !== 30, age_s: 0.5, lost_ticks: 0, lost_messages: 0 }));
            const systemStatus = { ...plumb.data.systemStatus, vehicles };
            Object.defineProperty(plumb.data, 'systemStatus', { get: () => systemStatus, set() {} });
        })()",
    );
    page.until("plumb.drawn()?.summary === '50 vehicles: 49 current, 0 old, 1 unreachable; 0 with losses'");
    page.click("#problems-first");
    page.until("plumb.drawn().vehicles[0].vehicle === 'drone-30' && document.querySelector('[data-vehicle]').dataset.vehicle === 'drone-30'");
    page.shot("fleet-fifty.png");
    page.eval("document.getElementById('filter').value = '-4'");
    page.until("plumb.drawn().vehicles.length === 11 && document.querySelectorAll('[data-vehicle]').length === 11");
    page.assert_clean();
    view.stop();
    drone_runs.interrupt();
    drone_runs.wait().assert_complete();
    // The attitude file uses the frames north-east-down and forward-right-down. The page shows the
    // native frames.
    let row = row(&out, tick);
    assert_eq!(drawn, [row[1], row[3], row[2], -row[4]], "tick {tick}");
}

#[test]
fn named_vehicle_is_shown_and_found_after_restart() {
    let boat = vehicle("boat", "");
    let running = boat.start(&[]);
    let end = endpoint(&boat);
    let view = view(&boat, &["boat", "--connect", &end]);
    let Some(mut page) = Page::open(&view.address) else { return };
    page.until("plumb.view() === 'fly' && plumb.state().kind === 'live' && plumb.drawn()?.quaternion");
    running.interrupt();
    running.wait().assert_complete();
    page.until("plumb.state().kind !== 'live'");
    let restarted = boat.start(&[]);
    wait_for("the gateway", || gateway(&boat).is_some());
    page.until("plumb.state().kind === 'live'");
    page.assert_clean();
    view.stop();
    restarted.interrupt();
    restarted.wait().assert_complete();
}

#[test]
fn operator_swaps_stage_of_remote_vehicle() {
    let site = Site::new(&[&["vehicle", "alpha", "--host", "127.0.0.1"], &["operator", "ann"]]);
    let alpha = listening_vehicle(&site, free_port());
    let running = alpha.start(&[]);
    let end = endpoint(&alpha);
    let keys = site.holder_folder("operator.ann");
    let view = view(&alpha, &["alpha", "--connect", &end, "--keys", keys.to_str().unwrap()]);
    let Some(mut page) = Page::open(&view.address) else { return };
    page.until("plumb.state().kind === 'live'");
    page.key("4");
    page.until("document.getElementById('slot').value === 'fuser' && !document.getElementById('swap').disabled");
    page.eval("document.getElementById('stage').value = 'vqf'");
    page.click("#swap");
    page.click("#yes");
    page.until("/^(committed|aborted|refused)/.test(document.getElementById('outcome').textContent)");
    let outcome = page.text("document.getElementById('outcome').textContent");
    assert!(outcome.starts_with("committed: fuser: multiple-model → vqf from tick"), "{outcome}");
    page.assert_clean();
    view.stop();
    running.interrupt();
    running.wait().assert_complete();
}
