//! Vehicles as a printed table.

use attitude::frames::Frame;
use messages::AttitudeOutput;
use remote::fleet::Vehicles;
use wire::delivery::DeliveryTracker;

/// Returns a table of the vehicles, and the details of one of them.
pub(super) fn table(vehicles: &Vehicles, detail: Option<&str>) -> String {
    if vehicles.is_empty() {
        return "no vehicle yet".into();
    }
    let mut lines = vec![format!("{:<17}{:<6}{:>9}{:>8}  {}", "vehicle", "alive", "messages", "lost", "services")];
    for (name, vehicle) in vehicles {
        let alive = if vehicle.is_alive { "yes" } else { "no" };
        let services: Vec<_> = vehicle.services.iter().map(ToString::to_string).collect();
        lines.push(format!(
            "{name:<17}{alive:<6}{:>9}{:>8}  {}",
            vehicle.messages(),
            vehicle.lost(),
            services.join(" ")
        ));
    }
    let shown =
        detail.or(vehicles.keys().next().map(String::as_str)).and_then(|name| Some((name, vehicles.get(name)?)));
    if let Some((name, vehicle)) = shown {
        lines.push(format!(
            "{name}: {}",
            vehicle.attitude.as_ref().map_or("no attitude yet".into(), |output| attitude(output, vehicle.frame))
        ));
        lines.push(format!("  {:<11}{}", "topic", DeliveryTracker::HEADER));
        for (topic, tracker) in &vehicle.trackers {
            lines.push(format!("  {topic:<11}{tracker}"));
        }
    }
    lines.join("\n")
}

fn attitude(output: &AttitudeOutput, frame: Frame) -> String {
    let AttitudeOutput { yaw_rad, pitch_rad, roll_rad, course_rad, course_reference, .. } = *output;
    let [yaw, pitch, roll, course] = [yaw_rad, pitch_rad, roll_rad, course_rad].map(f64::to_degrees);
    let reference = course_reference.name();
    format!(
        "yaw {yaw:+7.2}°  pitch {pitch:+6.2}°  roll {roll:+7.2}°  course {course:5.1}° ({reference})  {}",
        frame.name()
    )
}
