"""Training of a surrogate of any family from the command line, and its card."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sdm.cli.common.printed_line import print_line


def train_of_family(name: str, out: Path, *, budget_s: float | None, resolution: int, seed: int, device: str) -> None:
    """Train, write the surrogate, measure its card and draw it.

    Args:
        name: The family, as every command takes it.
        out: Folder to write to.
        budget_s: Seconds of the training; the card comes after it.
        resolution: Voxels along each axis.
        seed: Of shapes and network.
        device: Where.
    """
    from sdm.core.device import choose_device
    from sdm.errors import SDMError
    from sdm.io.files.atomic import replacing
    from sdm.io.files.json_file import write_json
    from sdm.shapes import family_record, load_family
    from sdm.shapes.family import check_resolution
    from sdm.surrogate.families.family_card import measure_card
    from sdm.surrogate.families.family_file import save_family_surrogate
    from sdm.surrogate.families.train_family import exact_maps, train_family
    from sdm.training.budget import check_budget
    from sdm.training.checkpoints import training_folder
    from sdm.viz.card_sheet import card_sheet

    if budget_s is None:
        raise SDMError("say how long to train: --budget-s")
    check_budget(budget_s)
    check_resolution(resolution)
    where = choose_device(device)
    family = load_family(name)
    with training_folder(out):
        grid = family.grid(resolution)
        model, grid = train_family(
            family, grid, budget_s=budget_s, seed=seed, device=where, report=lambda line: print(line, flush=True)
        )
        training = {"budget_s": budget_s, "seed": seed, "device": where.type}
        save_family_surrogate(model, grid, family_record(family), out, training=training)
        print("measuring it: fresh shapes, and a search for the worst ones", flush=True)
        card = measure_card(model, family, grid, seed=seed, device=where)
        units = {p.unit for p in family.parameters} & {"mm", "m", "cm"}
        card = {"family": family.name, "training": training, "unit": units.pop() if len(units) == 1 else None, **card}
        write_json(out / "card.json", card)
        with replacing(out / "card.md") as part:
            part.write_text(card_text(card))
        import torch

        place = torch.tensor([list(card["worst"]["dice"]["theta"].values())], device="cpu")
        exact = exact_maps(family, place, grid, where)[0].cpu().numpy()
        with torch.no_grad():
            guess = model(place)[0, 0].numpy()
        card_sheet(
            exact, guess, card, out / "card.png", title=f"{family.name}: {resolution}^3 voxels of {card['voxel']:.3g}"
        )
    unit = f" {card['unit']}" if card["unit"] else ""
    print_line(
        f"{out}: mean error {card['mean']:.3g}{unit}, near the surface {card['near']:.3g}{unit}, "
        f"Dice {card['dice']:.4f}, the least found {card['worst']['dice']['dice']:.4f}; see card.md"
    )


def card_text(card: dict[str, Any]) -> str:
    """The card as Markdown."""
    unit = f" {card['unit']}" if card["unit"] else ""
    lines = [
        f"# Surrogate of {card['family']}",
        "",
        (
            f"Trained for {card['training']['budget_s']:g} s on {card['training']['device']}; voxels of "
            f"{card['voxel']:.4g}{unit}. Errors are absolute, of {card['fresh']} shapes that the training has not seen."
        ),
        "",
        "| | mean error | near the surface | largest | Dice |",
        "|---|---|---|---|---|",
        (
            f"| fresh shapes | {card['mean']:.3g}{unit} | {card['near']:.3g}{unit} | {card['largest']:.3g}{unit} | "
            f"{card['dice']:.4f}, least {card['dice_least']:.4f} |"
        ),
    ]
    for name, said in (("dice", "least Dice found"), ("mean", "largest mean error found")):
        row = card["worst"][name]
        lines.append(
            f"| {said} | {row['mean']:.3g}{unit} | {row['near']:.3g}{unit} | {row['largest']:.3g}{unit} | "
            f"{row['dice']:.4f} |"
        )
    lines += [
        "",
        "The worst cases were found by search over the box of parameters, which is no proof that none is worse:",
    ]
    for name in ("dice", "mean"):
        place = ", ".join(f"{key} {value:.4g}" for key, value in card["worst"][name]["theta"].items())
        lines.append(f"{name}: {place}.")
    lines += ["", "| distance from the box's centre | shapes | mean error |", "|---|---|---|"]
    lines += [
        f"| {b['from']:.1f} to {b['to']:.1f} | {b['shapes']} | {b['mean']:.3g}{unit} |"
        for b in card["by_distance_from_centre"]
    ]
    lines += ["", "| one map by | ms |", "|---|---|", *(f"| {key} | {value} |" for key, value in card["speed"].items())]
    return "\n".join([*lines, "", "![worst case](card.png)", ""])
