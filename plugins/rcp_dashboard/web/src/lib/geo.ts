/** The Earth near one place as a plane: east and north in metres. Good for the reach of a robot. */

const RADIUS = 6_378_137; // m

export interface Geo {
  latitude: number;
  longitude: number;
}

export function toMetres(at: Geo, origin: Geo): { x: number; y: number } {
  const rad = Math.PI / 180;
  return {
    x: (at.longitude - origin.longitude) * rad * RADIUS * Math.cos(origin.latitude * rad),
    y: (at.latitude - origin.latitude) * rad * RADIUS,
  };
}

export function toGeo(x: number, y: number, origin: Geo): Geo {
  const rad = Math.PI / 180;
  return {
    latitude: origin.latitude + y / RADIUS / rad,
    longitude: origin.longitude + x / (RADIUS * Math.cos(origin.latitude * rad)) / rad,
  };
}

/** The greatest of 1, 2 and 5 times a power of ten that is not above a length. */
export function round(length: number): number {
  const power = 10 ** Math.floor(Math.log10(length));
  return power * (length / power >= 5 ? 5 : length / power >= 2 ? 2 : 1);
}
