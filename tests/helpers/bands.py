"""Real scenes on which tables with spectral outputs are evaluated."""

from pathlib import Path

DAYS, FACES = ("01", "06", "13"), (1, 2, 4, 5, 6)
NANOMETRES = [405, 435, 450, 470, 505, 525, 570, 590, 630, 645, 660, 700, 780, 850, 870, 890, 910, 940, 970]
BORDER = 10  # pixels


def unseen_scenes(data: Path) -> str:
    """Return a scene recipe with spectral cubes and faces from the data folder."""
    head = 'illuminants = ["D65"]\nexposure_share = [0.9]\n[target]\noutputs = "camera"\n'
    cubes = [
        f'[[scene]]\nsource = "cube"\nfile = "{data}/scenes/multispectral_day{day}.mat"\nwavelengths_nm = {NANOMETRES}\n'
        for day in DAYS
    ]
    faces = [f'[[scene]]\nsource = "iset"\nfile = "{data}/scenes/people_small_{face}_scene.mat"\n' for face in FACES]
    return head + "".join(cubes + faces)
