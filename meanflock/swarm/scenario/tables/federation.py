"""Table of the rounds in which models are shared."""

from typing import Annotated, Any, Literal

from msgspec import field

from meanflock.swarm.scenario.described import OURS, PRINTED, SILENT, key
from meanflock.swarm.toml import Table as _Table


class Federation(_Table, frozen=True):
    """Rounds in which the UAVs share their models."""

    period: (
        Annotated[
            int,
            key(
                "n0, ticks between rounds; unset: the number that the controller declares",
                PRINTED,
                "100 for H and F, 200 for HF; one sentence of the paper has 100 for all",
                unit="ticks",
                ge=1,
            ),
        ]
        | None
    ) = None
    fraction: Annotated[float, key("N_h / N, share of the UAVs that upload in a round", PRINTED, "", gt=0, le=1)] = 0.8
    group: (
        Annotated[
            str | tuple[str, ...],
            key(
                "the group, or a list of groups, whose UAVs take part in rounds; unset: all whose controller or "
                "learner shares a model",
                OURS,
                "all UAVs take part",
                later=True,
            ),
        ]
        | None
    ) = None
    leader: Annotated[int, key("h, the UAV that carries the leader", SILENT, "any UAV will do", ge=0)] = 0
    station: (
        Annotated[
            int,
            key(
                "the station where the leader averages; if it is lost, the next one in order, and without any the UAV "
                "`federation.leader` carries the leader again; unset: that UAV carries it",
                OURS,
                "the paper's leader flies",
                later=True,
                ge=0,
            ),
        ]
        | None
    ) = None
    state_period: Annotated[
        int,
        key(
            "n_s, ticks between broadcasts of the state by `mfg`; 0: initial states only",
            SILENT,
            "the paper does not say how often `mfg` shares states; 0 shares the initial ones only",
            unit="ticks",
            ge=0,
        ),
    ] = 0
    aggregation: Annotated[
        str,
        key(
            "aggregation rule, by which the leader makes one model of many; see `meanflock plugins`",
            PRINTED,
            "FedAvg",
            later=True,
        ),
    ] = "fedavg"
    options: Annotated[dict[str, Any], key("options of that rule", OURS, "a rule declares its own", later=True)] = (
        field(default_factory=dict)
    )
    tolerance: Annotated[
        float,
        key(
            "share of the uploads that `trimmed-mean` and `krum` assume to be false",
            OURS,
            "a quarter of the uploads may be false",
            later=True,
            ge=0,
            lt=0.5,
        ),
    ] = 0.25
    byzantine_fraction: Annotated[
        float, key("share of the UAVs whose uploads are false", OURS, "all uploads are true", later=True, ge=0, le=1)
    ] = 0.0
    byzantine_kind: Annotated[
        Literal["huge", "sign-flip", "boost", "noise"],
        key("content of a false upload", OURS, "no effect if all uploads are true", later=True),
    ] = "sign-flip"
    payload: (
        Annotated[
            str,
            key(
                "coding of uploads, see `meanflock plugins`; unset: the radio's floats",
                OURS,
                "the paper's floats; narrower ones are measured in [communication](communication.md)",
                later=True,
            ),
        ]
        | None
    ) = None
    payload_options: Annotated[
        dict[str, Any], key("options of that coding", OURS, "a coding declares its own", later=True)
    ] = field(default_factory=dict)
    broadcast_payload: (
        Annotated[str, key("coding of the global model; unset: the radio's floats", OURS, "likewise", later=True)]
        | None
    ) = None
    error_feedback: Annotated[
        bool,
        key(
            "add the rounding error of an upload to the same UAV's next upload",
            OURS,
            "without it rounding errors add up; see [communication](communication.md)",
            later=True,
        ),
    ] = True
    deadline: (
        Annotated[
            float,
            key(
                "time after which a round is averaged; later uploads count in the next one; unset: the latency "
                "threshold, after which an upload is lost, s",
                OURS,
                "on the paper's radio an upload takes 0.4 ms at most, so none is late",
                later=True,
                gt=0,
            ),
        ]
        | None
    ) = None
    fragment: (
        Annotated[
            int,
            key(
                "slots of a fragment into which models are cut; 0: models are never cut; unset: models that need more "
                "than the latency threshold are cut into the longest fragments of which 95 % arrive, and so are those "
                "in space of which more than half would be lost",
                OURS,
                "the paper's models fit into one message; [federation](federation.md) says what longer ones do",
                later=True,
                ge=0,
            ),
        ]
        | None
    ) = None
    retries: Annotated[
        int,
        key(
            "times that a fragment of a model, or a whole one, is transmitted again if no acknowledgement came; these "
            "are billed, too",
            OURS,
            "the paper's UAVs transmit a model once",
            later=True,
            ge=0,
            le=100,
        ),
    ] = 0
    share: Annotated[
        float,
        key(
            "share of the fragments of a model that an upload has: those that moved most since they were sent last",
            OURS,
            "models are uploaded whole",
            later=True,
            gt=0,
            le=1,
        ),
    ] = 1.0
    upload_threshold: Annotated[
        float,
        key(
            "a UAV uploads only if its model has moved by more than this share of the model that it sent last; 0: in "
            "every round",
            OURS,
            "the paper's UAVs upload in every round",
            later=True,
            ge=0,
        ),
    ] = 0.0
    range_m: (
        Annotated[
            float,
            key(
                "distance that uploads, relays and global models reach; unset: any distance",
                PRINTED,
                "the paper's uploads and global models reach any distance",
                unit="m",
                later=True,
                gt=0,
            ),
        ]
        | None
    ) = None
    topology: (
        Annotated[
            str,
            key(
                "topology, see `meanflock plugins`; unset: `leader`, or `clusters` if K > 1",
                OURS,
                "one leader averages all models",
                later=True,
            ),
        ]
        | None
    ) = None
    clusters: Annotated[
        int,
        key(
            "K, number of clusters whose heads average for the leader; 1: no clusters",
            OURS,
            "one leader for all UAVs; [scaling](scaling.md) says what clusters cost and save",
            later=True,
            ge=1,
        ),
    ] = 1

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups that take part in rounds; none: all UAVs do."""
        return (self.group,) if isinstance(self.group, str) else self.group or ()
