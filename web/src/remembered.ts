/** A setting of this browser that survives a reload: written in the click itself, since an effect may come after the page is gone. */
import { useState } from "preact/hooks";

export function useRemembered<Value extends string>(key: string, values: readonly [Value, ...Value[]]): [Value, (value: Value) => void] {
  const [value, setValue] = useState<Value>(() => values.find((known) => known === read(key)) ?? values[0]);
  return [value, (chosen) => {
    setValue(chosen);
    try {
      localStorage.setItem(key, chosen);
    } catch {
      // A browser that keeps nothing still shows what was chosen, until the next reload.
    }
  }];
}

function read(key: string): string | null {
  try {
    return localStorage.getItem(key);
  } catch {
    return null;
  }
}
