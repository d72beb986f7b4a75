//! Off-board communication: links, sessions and certificates, gateway, stations, split systems,
//! third-party clients and impaired networks.

mod bridge;
mod certificates;
mod foreign_vehicles;
mod gateway;
mod impaired_network;
mod links;
mod remote_topics;
mod sessions;
mod split;
mod subscription;
mod third_party_client;
mod uncertified_clients;
