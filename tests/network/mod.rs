//! Beyond the board: links, sessions and their certificates, gateway, stations, split systems, foreign clients, rough networks.

mod bridge;
mod certificates;
mod docs;
mod elsewhere;
mod foreign;
mod gateway;
mod links;
mod rough_network;
mod sessions;
mod split;
mod strangers;
