"""`sdm train segmentation`, `sdm segment` and `sdm evaluate`, from files to files."""

from __future__ import annotations

import json

import nibabel as nib
import numpy as np
import pytest

import sdm
from sdm.cli import main
from tests.helpers.segmentation_cases import AFFINE, SHAPE, volume, write_hdf5, write_nnunet

QUICK = ["--patch", "16", "16", "16", "--filters", "4", "--network", "unet", "--batch-size", "2", "--device", "cpu"]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("segmentation")
    write_nnunet(folder / "data")
    words = ["train", "segmentation", "--data", str(folder / "data"), "--out", str(folder / "net"), "--method", "pwr"]
    assert main([*words, *QUICK, "--steps", "50", "--learning-rate", "0.01"]) == 0
    return folder


def test_from_images_to_scores(trained, tmp_path, capsys):
    """The label and its map have the image's geometry; the map is in mm and negative inside."""
    capsys.readouterr()
    images = str(trained / "data" / "imagesTs")
    out = tmp_path / "out"
    assert main(["segment", images, "--model", str(trained / "net" / "model.pt"), "--out", str(out)]) == 0
    label = nib.load(out / "case3.nii.gz")
    assert np.allclose(label.affine, AFFINE)
    assert label.get_data_dtype() == np.uint8
    inside = np.asarray(label.dataobj) > 0
    assert inside.any()
    field = sdm.load(out / "case3_sdm.nii.gz")
    assert np.allclose(field.grid.affine, AFFINE)
    assert np.array_equal(field.numpy() < 0, inside)
    # Between two voxels across the surface there is half of a voxel's size on either side.
    assert np.abs(field.numpy()).min() == pytest.approx(0.4, abs=1e-5)
    capsys.readouterr()
    scores = tmp_path / "scores.json"
    truths = str(trained / "data" / "labelsTs")
    assert main(["evaluate", str(out), truths, "--json", str(scores)]) == 0
    assert "| case3 |" in capsys.readouterr().out
    assert json.loads(scores.read_text())["case3"]["dice"] > 0.5


def test_scores_of_validation_cases_are_printed(trained, tmp_path, capsys):
    words = ["train", "segmentation", "--data", str(trained / "data"), "--out", str(tmp_path), *QUICK, "--steps", "2"]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "baseline, 2 steps on 3 cases" in said
    assert "| baseline |" in said


def test_labels_without_images_are_shapes_for_synthetic_cases(trained, tmp_path, capsys):
    words = ["train", "segmentation", "--data", str(trained / "data"), "--out", str(tmp_path / "net"), *QUICK]
    words += ["--steps", "2", "--method", "head-sdf-l2", "--synthetic", "1"]
    shapes = str(trained / "data" / "labelsTs")
    assert main([*words, "--labels", shapes]) == 0
    assert "head-sdf-l2, 2 steps on 3 cases" in capsys.readouterr().out
    (tmp_path / "empty").mkdir()
    assert main([*words, "--labels", str(tmp_path / "empty")]) == 2
    assert "holds no labels" in capsys.readouterr().err
    assert main([*words, "--labels", str(tmp_path / "nowhere")]) == 2
    assert "is not there" in capsys.readouterr().err
    _, label = volume(1)
    nib.save(nib.Nifti1Image(label, np.diag([2.0, 2, 2, 1])), tmp_path / "empty" / "a.nii.gz")
    assert main([*words, "--labels", str(tmp_path / "empty")]) == 2
    assert "resample it" in capsys.readouterr().err


def test_a_training_cut_short_goes_on(trained, tmp_path, capsys):
    words = ["train", "segmentation", "--data", str(trained / "data"), "--out", str(tmp_path), *QUICK, "--steps", "3"]
    assert main([*words, "--budget-s", "0"]) == 0
    assert "0 of 3 steps are done" in capsys.readouterr().out
    assert not (tmp_path / "model.pt").exists()
    before = (tmp_path / "checkpoint.pt").read_bytes()
    assert "keeps an unfinished training: --resume goes on with it; or remove it" in refused(words, capsys)
    assert (tmp_path / "checkpoint.pt").read_bytes() == before
    assert main([*words, "--resume"]) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["model.pt"]
    assert main(words) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["model.pt"]


@pytest.mark.parametrize("budget", ["nan", "-1"])
def test_budgets_that_are_none(trained, tmp_path, capsys, budget):
    capsys.readouterr()
    words = ["train", "segmentation", "--data", str(trained / "data"), "--out", str(tmp_path / "net"), *QUICK]
    assert f"a budget of {budget} seconds trains nothing" in refused([*words, "--budget-s", budget], capsys)
    assert not (tmp_path / "net").exists()


def refused(words, capsys) -> str:
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    return said.err


def test_a_network_that_cannot_be_written_is_not_trained(trained, tmp_path, capsys):
    (tmp_path / "model.pt").mkdir()
    words = ["train", "segmentation", "--data", str(trained / "data"), "--out", str(tmp_path), *QUICK]
    capsys.readouterr()
    assert "model.pt cannot be written: a folder of that name is there" in refused([*words, "--steps", "2"], capsys)


def test_bad_cases_are_refused_before_training(tmp_path, capsys):
    image, label = volume(0)
    write_hdf5(tmp_path / "data" / "good.h5", image, label)
    write_hdf5(tmp_path / "data" / "empty.h5", image, 0 * label)
    write_hdf5(tmp_path / "data" / "other.h5", image, label[1:])
    words = ["train", "segmentation", "--data", str(tmp_path / "data"), "--out", str(tmp_path / "net"), *QUICK]
    said = refused(words, capsys)
    assert "2 of 3 cases cannot be used: empty has no foreground; other has an image of shape (26, 24, 20)" in said
    assert not (tmp_path / "net").exists()


def test_unknown_methods_and_missing_files(trained, tmp_path, capsys):
    data, model = str(trained / "data"), str(trained / "net" / "model.pt")
    out = ["--out", str(tmp_path / "out")]
    assert "choose one of baseline" in refused(
        ["train", "segmentation", "--data", data, "--method", "best", *out], capsys
    )
    assert "is not there" in refused(["segment", str(tmp_path / "x.nii.gz"), "--model", model, *out], capsys)
    image = str(trained / "data" / "imagesTs" / "case3_0000.nii.gz")
    assert "model.pt" in refused(["segment", image, "--model", str(tmp_path / "no.pt"), *out], capsys)
    assert not (tmp_path / "out").exists()


def test_images_of_another_voxel_size_are_refused(trained, tmp_path, capsys):
    nib.save(nib.Nifti1Image(volume(0)[0], np.diag([2.0, 2, 2, 1])), tmp_path / "a.nii.gz")
    words = ["segment", str(tmp_path / "a.nii.gz"), "--model", str(trained / "net" / "model.pt")]
    assert "a.nii.gz has voxels of 2 x 2 x 2 mm" in refused([*words, "--out", str(tmp_path / "out")], capsys)


def test_a_network_of_a_newer_program_is_one_sentence(trained, tmp_path, capsys):
    import torch

    state = torch.load(trained / "net" / "model.pt", weights_only=True)
    state["settings"]["novel"] = 1
    torch.save(state, tmp_path / "model.pt")
    words = ["segment", str(trained / "data" / "imagesTs"), "--model", str(tmp_path / "model.pt")]
    said = refused([*words, "--out", str(tmp_path / "out")], capsys)
    assert "model.pt has settings that this program does not know" in said


def test_labels_that_do_not_fit(trained, tmp_path, capsys):
    truths = trained / "data" / "labelsTr"
    (tmp_path / "p").mkdir()
    path = tmp_path / "p" / "case0.nii.gz"
    nib.save(nib.Nifti1Image(np.ones((3, 3, 3), np.uint8), AFFINE), path)
    assert "has the shape (3, 3, 3)" in refused(["evaluate", str(path), str(truths)], capsys)
    moved = AFFINE.copy()
    moved[2, 3] += 2
    nib.save(nib.Nifti1Image(np.ones(SHAPE, np.uint8), moved), path)
    assert "different places" in refused(["evaluate", str(path), str(truths)], capsys)
    path.rename(tmp_path / "p" / "nobody.nii.gz")
    assert "no label for nobody" in refused(["evaluate", str(tmp_path / "p"), str(truths)], capsys)


@pytest.mark.parametrize(
    ("value", "words"),
    [(0.3, "has values such as 0.3: threshold probabilities first"), (np.nan, "not finite"), (-np.inf, "not finite")],
)
def test_what_is_no_label_is_not_scored(value, words, tmp_path, capsys):
    label = volume(0)[1].astype(np.float32)
    soft = np.where(label == 0, value, label).astype(np.float32)
    nib.save(nib.Nifti1Image(label, AFFINE), tmp_path / "label.nii.gz")
    nib.save(nib.Nifti1Image(soft, AFFINE), tmp_path / "soft.nii.gz")
    write_hdf5(tmp_path / "soft.h5", label, soft)
    for pair in (["soft.nii.gz", "label.nii.gz"], ["label.nii.gz", "soft.nii.gz"], ["label.nii.gz", "soft.h5"]):
        said = refused(["evaluate", *(str(tmp_path / name) for name in pair)], capsys)
        assert words in said
        assert "soft" in said


def test_of_two_labels_of_one_name_none_is_chosen(tmp_path, capsys):
    for name, label in (("p/a.nii.gz", volume(0)[1]), ("t/a.nii.gz", volume(0)[1]), ("t/a.nii", volume(1)[1])):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        nib.save(nib.Nifti1Image(label, AFFINE), tmp_path / name)
    for pair in (["p", "t"], ["t", "p"]):
        said = refused(["evaluate", *(str(tmp_path / name) for name in pair)], capsys)
        assert "a.nii and a.nii.gz have one name" in said


def test_labels_as_scaled_integers_are_scored(tmp_path, capsys):
    label = volume(0)[1]
    nib.save(nib.Nifti1Image(label, AFFINE), tmp_path / "label.nii.gz")
    scaled = nib.Nifti1Image(np.where(label, 255, 0).astype(np.uint8), AFFINE)
    scaled.header.set_slope_inter(1 / 255, 0)
    nib.save(scaled, tmp_path / "scaled.nii.gz")
    assert main(["evaluate", str(tmp_path / "scaled.nii.gz"), str(tmp_path / "label.nii.gz")]) == 0
    assert "100.00" in capsys.readouterr().out


def test_sheared_labels_are_not_scored(tmp_path, capsys):
    sheared = AFFINE.copy()
    sheared[0, 1] = 0.4
    path = tmp_path / "label.nii.gz"
    nib.save(nib.Nifti1Image(volume(0)[1], sheared), path)
    said = refused(["evaluate", str(path), str(path)], capsys)
    assert "label.nii.gz" in said
    assert "sheared" in said


def test_an_empty_prediction_is_said_to_have_failed(trained, tmp_path, capsys):
    nib.save(nib.Nifti1Image(np.zeros(SHAPE, np.uint8), AFFINE), tmp_path / "case0.nii.gz")
    scores = tmp_path / "scores.json"
    assert main(["evaluate", str(tmp_path), str(trained / "data" / "labelsTr"), "--json", str(scores)]) == 0
    said = capsys.readouterr().out
    case = json.loads(scores.read_text(), parse_constant=pytest.fail)["case0"]
    assert case["failed"] is True
    assert case["dice"] == 0
    assert case["hausdorff95_mm"] is None
    assert "| case0 | 0.00 |" in said
    assert "failed, for one of the two labels is empty: case0" in said


def test_where_both_labels_are_empty_nothing_has_failed(tmp_path, capsys):
    for folder in ("p", "t"):
        (tmp_path / folder).mkdir()
        for name, label in (("full", volume(0)[1]), ("none", np.zeros(SHAPE, np.uint8))):
            nib.save(nib.Nifti1Image(label, AFFINE), tmp_path / folder / f"{name}.nii.gz")
    assert main(["evaluate", str(tmp_path / "p"), str(tmp_path / "t")]) == 0
    said = capsys.readouterr().out
    assert "| none | - | - | - | - | - | - |" in said
    assert "| mean of 2 | 100.00 | 100.00 | 100.00 | 0.00 | 0.00 | 0.00 |" in said
    assert "failed" not in said
    assert "in no mean, for both labels are empty: none" in said
    assert "nothing was predicted" not in said


def test_truths_without_a_prediction_are_named(tmp_path, capsys):
    for folder, names in (("p", ("a",)), ("t", ("a", "b", "c"))):
        (tmp_path / folder).mkdir()
        for name in names:
            nib.save(nib.Nifti1Image(volume(0)[1], AFFINE), tmp_path / folder / f"{name}.nii.gz")
    assert main(["evaluate", str(tmp_path / "p"), str(tmp_path / "t")]) == 0
    assert "in no mean, for nothing was predicted: b, c" in capsys.readouterr().out
    assert main(["evaluate", str(tmp_path / "p" / "a.nii.gz"), str(tmp_path / "t")]) == 0
    assert "nothing was predicted" not in capsys.readouterr().out


@pytest.mark.parametrize("name", ["nowhere/scores.json", "folder"])
def test_a_place_for_scores_that_cannot_be_is_refused_before_they_are_made(name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    nib.save(nib.Nifti1Image(volume(0)[1], AFFINE), tmp_path / "label.nii.gz")
    said = refused(["evaluate", "label.nii.gz", "label.nii.gz", "--json", name], capsys)
    assert "cannot be written" in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "label.nii.gz"]


def test_an_older_distance_map_does_not_stay_beside_an_empty_label(trained, tmp_path):
    import torch

    from sdm.segmentation import write_prediction
    from sdm.segmentation.data.folder import read_images

    (case,) = read_images([trained / "data" / "imagesTs"])
    some = torch.zeros(case.image.shape, dtype=torch.bool)
    some[3:6, 3:6, 3:6] = True
    label, distances = write_prediction(case, some, tmp_path)
    assert sorted(tmp_path.iterdir()) == [label, distances]
    assert write_prediction(case, torch.zeros_like(some), tmp_path) == (label, None)
    assert list(tmp_path.iterdir()) == [label]


@pytest.mark.parametrize("codes", [(0, 0), (0, 1), (4, 0), (2, 1)])
def test_results_lie_in_the_space_of_their_image(codes, tmp_path):
    """A header that leaves the position open gives results that do: programs guess it in more than one way."""
    import torch

    from sdm.segmentation import write_prediction
    from sdm.segmentation.data.folder import read_images

    sform, qform = codes
    image = nib.Nifti1Image(volume(0)[0], AFFINE)
    image.set_sform(AFFINE, sform)
    image.set_qform(AFFINE, qform)
    nib.save(image, tmp_path / "a.nii.gz")
    (case,) = read_images([tmp_path / "a.nii.gz"])
    (tmp_path / "out").mkdir()
    for path in write_prediction(case, torch.from_numpy(volume(0)[1] != 0), tmp_path / "out"):
        assert path is not None
        found = nib.load(path)
        assert {int(found.header[name]) for name in ("sform_code", "qform_code")} == {sform or qform}
        assert np.allclose(found.affine, nib.load(tmp_path / "a.nii.gz").affine, atol=1e-5)
    assert np.allclose(sdm.load(path).grid.affine, case.affine, atol=1e-5)


def test_a_label_is_not_written_over_by_a_distance_map(trained, tmp_path, capsys):
    capsys.readouterr()
    paths = [str(tmp_path / f"{name}.nii.gz") for name in ("a_sdm", "a")]
    for path in paths:
        nib.save(nib.Nifti1Image(volume(0)[0], AFFINE), path)
    words = ["segment", *paths, "--model", str(trained / "net" / "model.pt"), "--out", str(tmp_path / "out")]
    assert "a_sdm.nii.gz would be one image's label and another's distance map" in refused(words, capsys)


def test_networks_are_told_positions(trained, tmp_path, capsys):
    data, images = str(trained / "data"), str(trained / "data" / "imagesTs")
    words = ["train", "segmentation", "--data", data, "--out", str(tmp_path), *QUICK, "--steps", "2"]
    assert main([*words, "--position", "--budget-s", "0"]) == 0
    capsys.readouterr()
    assert "with other settings: give those, or another file, or remove it" in refused([*words, "--resume"], capsys)
    assert main([*words, "--position", "--resume"]) == 0
    segment = ["segment", images, "--out", str(tmp_path / "out"), "--model", str(tmp_path / "model.pt")]
    assert main([*segment, "--mirrors"]) == 0
    assert (tmp_path / "out" / "case3.nii.gz").is_file()


def test_mirror_images_are_those_of_the_training(trained, tmp_path, capsys):
    data, images = str(trained / "data"), str(trained / "data" / "imagesTs")
    words = ["train", "segmentation", "--data", data, "--out", str(tmp_path), *QUICK, "--steps", "2"]
    words += ["--method", "pwr"]
    assert main([*words, "--mirrors", "", "--average", "0.5", "--schedule", "constant", "--last-dropout", "0.1"]) == 0
    capsys.readouterr()
    segment = ["segment", images, "--out", str(tmp_path / "out"), "--mirrors", "--model"]
    assert "leave out --mirrors" in refused([*segment, str(tmp_path / "model.pt")], capsys)
    both = [str(trained / "net" / "model.pt"), "--model", str(tmp_path / "model.pt")]
    assert "leave out --mirrors" in refused([*segment, *both], capsys)
    assert main([*segment, str(trained / "net" / "model.pt")]) == 0


@pytest.mark.parametrize("augment", ["none", "published"])
def test_mirror_images_are_those_of_the_augmentation(augment, trained, tmp_path, capsys):
    from sdm.segmentation import load_model, predict, predict_ensemble
    from sdm.segmentation.data.folder import read_images

    data, images = str(trained / "data"), trained / "data" / "imagesTs"
    words = ["train", "segmentation", "--data", data, "--out", str(tmp_path), *QUICK, "--steps", "2"]
    assert main([*words, "--augment", augment]) == 0
    capsys.readouterr()
    segment = ["segment", str(images), "--out", str(tmp_path / "out"), "--mirrors", "--model"]
    if augment == "none":
        assert "leave out --mirrors" in refused([*segment, str(tmp_path / "model.pt")], capsys)
        return
    trained_so, (case,) = load_model(tmp_path / "model.pt"), read_images([images])
    expected = predict(trained_so.model, case.image, (16, 16, 16), mirrors="xy").field
    assert predict_ensemble([trained_so], case.image, mirrors=True).field.equal(expected)


def test_several_networks_together(trained, tmp_path, capsys):
    """The label is that of the mean; one network given twice says what it says alone."""
    from sdm.segmentation import load_model, predict_ensemble
    from sdm.segmentation.data.folder import read_images

    data, images = str(trained / "data"), trained / "data" / "imagesTs"
    words = ["train", "segmentation", "--data", data, *QUICK, "--steps", "8", "--learning-rate", "0.01"]
    for name, method in (("a", "pwr"), ("b", "baseline"), ("c", "head-sdf-l1")):
        assert main([*words, "--method", method, "--seed", "1", "--out", str(tmp_path / name)]) == 0
    one, a, b, c = (folder / "model.pt" for folder in (trained / "net", *(tmp_path / n for n in "abc")))
    capsys.readouterr()

    def label(*models) -> np.ndarray:
        given = [word for path in models for word in ("--model", str(path))]
        assert main(["segment", *given, str(images), "--out", str(tmp_path / "out"), "--device", "cpu"]) == 0
        return np.asarray(nib.load(tmp_path / "out" / "case3.nii.gz").dataobj) > 0

    (case,) = read_images([images])
    for pair in ((one, a), (b, c)):
        expected = predict_ensemble([load_model(path) for path in pair], case.image).label.numpy()
        assert expected.any()
        assert np.array_equal(label(*pair), expected)
    assert np.array_equal(label(one, one), label(one))
    capsys.readouterr()
    segment = ["segment", str(images), "--out", str(tmp_path / "none")]
    assert "name its model.pt with --model" in refused(segment, capsys)
    said = refused([*segment, "--model", str(one), "--model", str(b)], capsys)
    assert f"{one} says a clipped signed distance of cases and {b} a probability, which have no mean" in said
    said = refused([*segment, "--model", str(one), "--model", str(tmp_path / "no.pt")], capsys)
    assert "no.pt is not there" in said
    assert not (tmp_path / "none").exists()


def test_several_classes_are_told_to_be_one_foreground(tmp_path, capsys):
    labels = np.zeros((6, 6, 6), np.uint8)
    labels[1:4, 1:4, 1:3], labels[1:4, 1:4, 3:5] = 1, 2
    for name, values in (("two", labels), ("one", labels > 0)):
        nib.save(nib.Nifti1Image(values.astype(np.uint8), np.eye(4)), tmp_path / f"{name}.nii.gz")
    assert main(["evaluate", str(tmp_path / "two.nii.gz"), str(tmp_path / "one.nii.gz")]) == 0
    said = capsys.readouterr()
    assert "| 100.00 |" in said.out
    assert "two.nii.gz has several classes, 1 to 2, and all count as foreground" in said.err
    assert said.err.count("\n") == 1
