"""Prometheus: the picture's totals and the server's own, rendered when somebody scrapes."""

from __future__ import annotations

from collections.abc import Iterable

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from groundstation.server.hub import Hub

SERVER_METRICS = {
    "groundstation_server_deltas_total": "Deltas published to pages.",
    "groundstation_server_clients": "Pages connected to the stream.",
    "groundstation_server_clients_refused_total": "Pages refused because there were too many.",
    "groundstation_server_clients_stalled_total": "Pages closed because they stopped reading.",
    "groundstation_server_events_total": "Events shown to the operator.",
    "groundstation_server_events_unsent_total": "Events that left memory before they were published.",
    "groundstation_server_rows_evicted_total": "Rows that gave way to newer ones, by table.",
    "groundstation_server_counters_refused_total": "Totals that had no room.",
    "groundstation_vehicles": "Vehicles known.",
    "groundstation_vehicles_lost": "Vehicles without a heartbeat for five seconds.",
    "groundstation_vehicle_clock_uncertainty_seconds": (
        "How far an autopilot's times may be off station time; none until they can be mapped."
    ),
    "groundstation_targets": "Beacons known.",
    "groundstation_links": "Radio links known.",
}
"""Name → help of every metric that the server itself gives."""


class HubCollector(Collector):
    """Reads the hub at the moment of the scrape."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub

    def describe(self) -> Iterable[Metric]:
        """Nothing beforehand: the totals of other rooms are not known yet."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Everything as it stands."""
        hub, picture = self._hub, self._hub.picture
        vehicles = picture.vehicle_rows()
        numbers = {
            "groundstation_server_deltas_total": hub.published_total,
            "groundstation_server_clients": len(hub.clients),
            "groundstation_server_clients_refused_total": hub.clients_refused_total,
            "groundstation_server_clients_stalled_total": hub.clients_stalled_total,
            "groundstation_server_events_total": picture.events_total,
            "groundstation_server_events_unsent_total": picture.events_unsent_total,
            "groundstation_server_counters_refused_total": picture.counters_refused_total,
            "groundstation_vehicles": len(vehicles),
            "groundstation_vehicles_lost": sum(row.lost for row in vehicles),
            "groundstation_targets": len(picture.targets),
            "groundstation_links": len(picture.links),
        }
        for name, value in numbers.items():
            family = CounterMetricFamily if name.endswith("_total") else GaugeMetricFamily
            yield family(name, SERVER_METRICS[name], value=value)
        clocks_name = "groundstation_vehicle_clock_uncertainty_seconds"
        clocks = GaugeMetricFamily(clocks_name, SERVER_METRICS[clocks_name], labels=["vehicle"])
        for row in vehicles:
            if row.clock_uncertainty_s is not None:
                clocks.add_metric([str(row.vehicle_id)], row.clock_uncertainty_s)
        yield clocks
        evicted_name = "groundstation_server_rows_evicted_total"
        evicted = CounterMetricFamily(evicted_name, SERVER_METRICS[evicted_name], labels=["table"])
        for table in (
            "vehicles",
            "links",
            "targets",
            "regions",
            "explanations",
            "proposals",
            "commands",
            "connections",
        ):
            evicted.add_metric([table], getattr(picture, table).evicted_total)
        yield evicted
        yield from self._room_counters()

    def _room_counters(self) -> Iterable[Metric]:
        families: dict[tuple[str, tuple[str, ...]], CounterMetricFamily] = {}
        for counter in self._hub.picture.counters.values():
            labels = tuple(key for key, _value in counter.labels)
            name = f"groundstation_{counter.name}"
            family = families.get((name, labels))
            if family is None:
                family = CounterMetricFamily(name, f"Running total {counter.name}.", labels=labels)
                families[name, labels] = family
            family.add_metric([value for _key, value in counter.labels], counter.value)
        yield from families.values()


def render(hub: Hub) -> bytes:
    """The text that Prometheus reads."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(HubCollector(hub))
    return generate_latest(registry)
