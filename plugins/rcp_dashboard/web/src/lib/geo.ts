/** The Earth near one place as a plane: east and north in metres. Good for the reach of a robot. */

const RADIUS = 6_378_137; // m

export interface Geo {
  latitude: number;
  longitude: number;
}

/** Where on Earth a value says something is; undefined where it does not know. */
export function geoOf(value: any): (Geo & { altitude?: number }) | undefined {
  const [latitude, longitude] = [value.latitude ?? value.lat, value.longitude ?? value.lon];
  if (!Number.isFinite(latitude) || !Number.isFinite(longitude) || (latitude === 0 && longitude === 0)) return undefined;
  const altitude = value.relative_altitude ?? value.relative_alt ?? value.altitude ?? value.alt;
  return { latitude, longitude, ...(Number.isFinite(altitude) && { altitude }) };
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
