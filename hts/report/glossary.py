"""What every figure and number of the page means."""

from __future__ import annotations

GLOSSARY = {
    "Improvement": (
        "The objective's own primary score of the policy against the pretrained policy; larger is better, zero is the "
        "pretrained policy."
    ),
    "95 % interval": (
        "How far the improvement would scatter if the seconds of this session were drawn again (contiguous stretches "
        "of them, because neighbouring seconds are alike). It speaks of this machine, real or simulated, on this "
        "occasion, not of other machines, days or sessions: where sessions differ it is too narrow, and hts evaluate "
        "DIR --sessions 4 gives one that holds over them. If it contains 0, no gain is shown."
    ),
    "Head-to-head": (
        "Both policies on one machine, one after the other in the order A-B-B-A, so that anything that drifts "
        "steadily, such as charge or heat, adds the same to both and cancels."
    ),
    "Segment": (
        "One second of walking whose mean forward speed is within the allowed deviation (10 % by default) of the "
        "commanded speed; for a robot with another task, one second in which it did that. The first two seconds after "
        "each change and everything near a fall are left out. The share in brackets is the valid part of all seconds."
    ),
    "Every second": (
        "The improvement, and its interval, when the seconds count too that were more than the allowed deviation from "
        "the asked speed. Where it is lower, the policy walks now faster, now slower, and pays for it in seconds that "
        "the improvement leaves out. Shown where some were left out."
    ),
    "Mean speed": (
        "Over the valid segments; in brackets that of the pretrained policy. Walking slower is not saving. Of another "
        "task: what was achieved."
    ),
    "Held speed, equal commands": (
        "Held: before its blocks the command of each policy is trimmed until the measured speed is the one asked for, "
        "then frozen, so both walk equally fast. Equal commands (open loop, as in the paper): both get the same "
        "command, and one may walk slower."
    ),
    "Falls": "How often the policy fell in its own blocks of the final head-to-head.",
    "Other columns of the result": (
        "Further measures that the objective gives for the same segments, named by the objective."
    ),
    "Pretrained, anchor, best": (
        "The policy the run started from; the policy a candidate was fine-tuned from and is kept close to; the elite "
        "with the best measured score, which is an anchor of the next iteration."
    ),
    "Candidate, elite": (
        "One fine-tuned policy of the sweep; one of those that scored best in simulation and were tested. 01-02-50 is "
        "01-02 as it was after half of its training, and 01-02-w50 lies halfway between it and its anchor."
    ),
    "KL, c": (
        "How far a candidate's actions are from its anchor's, on average over the states it visits, in nats; c is the "
        "bound that fine-tuning keeps it under (∞: none). Of candidates brought back towards their anchor (…-w50) it "
        "is over the states of their simulated trials."
    ),
    "λ": "Weight of the measured objective against the task in the reward.",
    "Score in simulation": (
        "Mean reward of the objective alone, by whatever paid in training (the measurement model of that iteration, if "
        "nothing else is said): larger is better. Scores of different iterations come from different models and are "
        "not comparable. A white cross marks a candidate that fell in simulation."
    ),
    "Front": (
        "With several objectives: the policies tried in reality for which no other is at least as good in all of them "
        "and better in one, the pretrained policy among them. Compared by what each objective selects by (counts as), "
        "which can be stricter than the improvement. Policies that fell are not on it."
    ),
    "Improvement during iterations": (
        "Measured in one shorter head-to-head each. The largest of several noisy numbers is flattering by nature; the "
        "final head-to-head measures the chosen policy afresh."
    ),
    "Predicted improvement": (
        "What the measurement model promises of a candidate by how it walks in simulation, before it is tried. Where "
        "it promises much more than is measured, the model was trusted where it had no data."
    ),
    "Measurement model": (
        "Predicts the measured quantity from what simulation knows too. Fitted on all recordings so far."
    ),
    "Held-out R²": (
        "Share of the variance of the measured quantity that the model explains in recordings it was not fitted on; 1 "
        "is perfect, 0 is no better than the mean."
    ),
    "Analytic stand-in": (
        "A formula of simulated quantities that the objective offers instead of a learned model, fitted to the same "
        "recordings as well as it can be: the baseline."
    ),
    "Rank correlation": (
        "Agreement between predicted and measured order of the policies that were tried in that iteration, the "
        "pretrained one among them, from −1 to 1 (Spearman): whether the model can tell a better policy from a worse "
        "one. Where nobody was tried, of the policies whose recordings were held out. Of two or three policies it says "
        "little."
    ),
    "Segment by segment": (
        "Each point is one second of the final head-to-head: the first quantity that the objective scores, relative to "
        "the mean of the pretrained policy. Short lines are means."
    ),
    "Steps in simulation, samples from reality": (
        "Control steps of all training, of judging candidates and of the gate; control steps of the robot's time, real "
        "or simulated, the pretrained policy's turns and the final among it."
    ),
}
"""Term -> its meaning, in the order of the page."""
