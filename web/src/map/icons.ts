// Symbols drawn on a canvas when the map first asks for them: no image files, every theme.
import type { Palette } from "../themes/palette";

const SIZE = 48;
const RATIO = 2;

type Pen = CanvasRenderingContext2D;

const disc = (pen: Pen): void => pen.arc(0, 0, 11, 0, 7);

/** A disc for the number, and a nose that points where the vehicle's does. */
function nosed(pen: Pen): void {
  pen.arc(0, 0, 11, -Math.PI / 2 + 0.7, (3 * Math.PI) / 2 - 0.7);
  pen.lineTo(0, -20);
  pen.closePath();
}

const drawings: Record<string, (pen: Pen, palette: Palette) => void> = {
  vehicle: (pen, palette) => solid(pen, nosed, palette.vehicle, palette.halo),
  "vehicle-lost": (pen, palette) => solid(pen, nosed, palette.vehicleLost, palette.halo),
  "vehicle-round": (pen, palette) => solid(pen, disc, palette.vehicle, palette.halo),
  "vehicle-round-lost": (pen, palette) => solid(pen, disc, palette.vehicleLost, palette.halo),
  beacon: (pen, palette) => {
    solid(pen, (p) => p.arc(0, 0, 8, 0, 7), palette.target, palette.halo);
    solid(pen, (p) => p.arc(0, 0, 3, 0, 7), palette.halo, palette.halo);
  },
  "place-offer": (pen, palette) => solid(pen, disc, palette.halo, palette.proposal),
  "place-sent": (pen, palette) => solid(pen, disc, palette.proposal, palette.halo),
};

function solid(pen: Pen, path: (pen: Pen) => void, fill: string, edge: string): void {
  pen.beginPath();
  path(pen);
  pen.lineWidth = 3;
  pen.lineJoin = "round";
  pen.strokeStyle = edge;
  pen.stroke();
  pen.fillStyle = fill;
  pen.fill();
}

export const iconRatio = RATIO;
export const iconNames = Object.keys(drawings);

export function icon(name: string, palette: Palette): ImageData | null {
  const draw = drawings[name];
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = SIZE * RATIO;
  const pen = canvas.getContext("2d");
  if (!draw || !pen) return null;
  pen.scale(RATIO, RATIO);
  pen.translate(SIZE / 2, SIZE / 2);
  draw(pen, palette);
  return pen.getImageData(0, 0, canvas.width, canvas.height);
}
